"""A decoder of take files that favours readability: it follows docs/take-format.md and docs/codec.md step by step."""
