"""The demo: every part of the project once, on one page."""
