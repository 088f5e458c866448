"""The studies behind the pages in docs/: `python -m touchd.model.studies`, from the repository."""
