"""Side-by-side runs against other tools; not part of the package or of the tests."""
