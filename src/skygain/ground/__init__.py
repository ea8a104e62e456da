"""What every room stands on and what knows no radio: errors, files, registries, processes."""
