"""Models from and to files and other libraries."""
