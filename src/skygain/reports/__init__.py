"""One survey shown: pictures, a page, files for other programs."""
