//! Calls that the serialport crate lacks: the descriptor of a port, and the kernel's low-latency mode.
//!
//! FTDI adapters hold received bytes for up to 16 ms; with `ASYNC_LOW_LATENCY` the kernel's driver reduces
//! that to 1 ms.

#![expect(
    unsafe_code,
    reason = "TTYPort returns its descriptor as an integer; no safe crate wraps the two ioctls"
)]

use std::{
    ffi::{c_char, c_int, c_uchar, c_uint, c_ulong, c_ushort},
    os::fd::{AsRawFd, BorrowedFd},
};

use rustix::ioctl::{Getter, Opcode, Setter, ioctl};
use serialport::TTYPort;

// From Linux's include/uapi: `asm-generic/ioctls.h`, `linux/serial.h`, `linux/tty_flags.h`.
const TIOCGSERIAL: Opcode = 0x541E;
const TIOCSSERIAL: Opcode = 0x541F;
const ASYNC_LOW_LATENCY: c_int = 1 << 13;

/// Other architectures have other request numbers, which are untested.
const HAS_KNOWN_IOCTLS: bool = cfg!(any(
    target_arch = "x86_64",
    target_arch = "x86",
    target_arch = "aarch64",
    target_arch = "arm",
    target_arch = "riscv64"
));

/// `struct serial_struct`.
#[repr(C)]
struct Serial {
    kind: c_int,
    line: c_int,
    port: c_uint,
    irq: c_int,
    flags: c_int,
    xmit_fifo_size: c_int,
    custom_divisor: c_int,
    baud_base: c_int,
    close_delay: c_ushort,
    io_type: c_char,
    reserved_char: [c_char; 1],
    hub6: c_int,
    closing_wait: c_ushort,
    closing_wait2: c_ushort,
    iomem_base: *mut c_uchar,
    iomem_reg_shift: c_ushort,
    port_high: c_uint,
    iomap_base: c_ulong,
}

const _: () = assert!(
    !HAS_KNOWN_IOCTLS
        || size_of::<Serial>() == if cfg!(target_pointer_width = "64") { 72 } else { 60 }
);

/// Borrows the port's descriptor.
pub(super) fn descriptor(port: &TTYPort) -> BorrowedFd<'_> {
    // SAFETY: a TTYPort keeps its descriptor open until it is dropped, and the result borrows it.
    unsafe { BorrowedFd::borrow_raw(port.as_raw_fd()) }
}

/// Requests low latency, and returns whether the port has it. Ptys and many drivers do not support it.
pub(super) fn set_low_latency(fd: BorrowedFd<'_>) -> bool {
    if !HAS_KNOWN_IOCTLS {
        return false;
    }
    // SAFETY: TIOCGSERIAL writes one `struct serial_struct`, and that is what `Serial` is.
    let get = unsafe { Getter::<TIOCGSERIAL, Serial>::new() };
    // SAFETY: `get` pairs the request with its type; the kernel writes nothing else.
    let Ok(mut serial) = (unsafe { ioctl(fd, get) }) else { return false };
    if serial.flags & ASYNC_LOW_LATENCY != 0 {
        return true;
    }
    serial.flags |= ASYNC_LOW_LATENCY;
    // SAFETY: TIOCSSERIAL reads one `struct serial_struct`: the one read above with one flag changed.
    let set = unsafe { Setter::<TIOCSSERIAL, Serial>::new(serial) };
    // SAFETY: `set` pairs the request with its type; the kernel writes nothing.
    unsafe { ioctl(fd, set) }.is_ok()
}
