"""The data-set store, its builder and its loader."""
