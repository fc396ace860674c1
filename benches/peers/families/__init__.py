"""One module for each family of published codecs. `all_codecs` is the list the bench runs."""
