"""Foreign formats: each module turns a file into raw columns; ``registry`` picks the module."""
