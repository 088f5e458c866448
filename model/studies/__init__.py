"""The studies behind the tables in docs/: `python -m touchd.model.studies` lists them."""
