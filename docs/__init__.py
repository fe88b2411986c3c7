"""The documentation: pages, and the code that makes figures and tables for them. `make docs` builds the site."""
