//! The file descriptor of a port, for what the serialport crate has no call for.

#![expect(unsafe_code, reason = "TTYPort gives its descriptor as a bare number")]

use std::os::fd::{AsRawFd, BorrowedFd};

use serialport::TTYPort;

/// The port's descriptor, for as long as the port is borrowed.
pub(super) fn descriptor(port: &TTYPort) -> BorrowedFd<'_> {
    // SAFETY: a TTYPort keeps its descriptor open until it is dropped, and the result borrows it.
    unsafe { BorrowedFd::borrow_raw(port.as_raw_fd()) }
}
