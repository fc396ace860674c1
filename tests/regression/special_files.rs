//! A FIFO or a device in place of a file is refused at once.
