//! A header that cannot be written leaves no file behind.
