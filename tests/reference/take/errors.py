"""Errors for bytes that no encoder wrote."""


class Corrupt(ValueError):
    """The bytes violate the format."""
