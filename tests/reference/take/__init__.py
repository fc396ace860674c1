"""A plain decoder of take files, written to be read: docs/take-format.md and docs/codec.md, step by step."""
