"""What is said of bytes that no encoder wrote."""


class Corrupt(ValueError):
    """The bytes are not what the format allows."""
