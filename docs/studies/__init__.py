"""The studies behind the pages in docs/: `python -m docs.studies`, from the repository."""
