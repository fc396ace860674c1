"""Published codecs, one module per family; `registry.all_codecs` lists those of the bench."""
