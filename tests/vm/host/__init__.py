"""What runs outside the emulated machine."""
