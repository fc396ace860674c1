"""What runs outside the emulated machine."""


class Absent(Exception):
    """This machine lacks a tool or knows no such package; the text says which."""


class Failed(Exception):
    """What should have gone well here did not; the text says what."""
