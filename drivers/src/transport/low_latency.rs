//! The kernel's low-latency switch for serial ports.
//!
//! FTDI adapters keep bytes for up to 16 ms before they send them on; with `ASYNC_LOW_LATENCY` the
//! kernel's driver sets that to 1 ms. The serialport crate has no such call.

#![cfg_attr(
    any(
        target_arch = "x86_64",
        target_arch = "x86",
        target_arch = "aarch64",
        target_arch = "arm",
        target_arch = "riscv64"
    ),
    expect(unsafe_code, reason = "two ioctls that no safe crate wraps")
)]

use std::os::fd::BorrowedFd;

/// Asks for low latency; whether the port has it now. A pty, and many drivers, know no such thing.
#[cfg(any(
    target_arch = "x86_64",
    target_arch = "x86",
    target_arch = "aarch64",
    target_arch = "arm",
    target_arch = "riscv64"
))]
pub(super) fn set(fd: BorrowedFd<'_>) -> bool {
    use kernel::{ASYNC_LOW_LATENCY, Serial, TIOCGSERIAL, TIOCSSERIAL};
    use rustix::ioctl::{Getter, Setter, ioctl};

    // SAFETY: TIOCGSERIAL writes one `struct serial_struct`, and that is what `Serial` is.
    let get = unsafe { Getter::<TIOCGSERIAL, Serial>::new() };
    // SAFETY: `get` pairs the request with its type; the kernel writes nothing else.
    let Ok(mut serial) = (unsafe { ioctl(fd, get) }) else {
        return false;
    };
    if serial.flags & ASYNC_LOW_LATENCY != 0 {
        return true;
    }
    serial.flags |= ASYNC_LOW_LATENCY;
    // SAFETY: TIOCSSERIAL reads one `struct serial_struct`, the one just got but for a flag.
    let set = unsafe { Setter::<TIOCSSERIAL, Serial>::new(serial) };
    // SAFETY: `set` pairs the request with its type; the kernel writes nothing.
    unsafe { ioctl(fd, set) }.is_ok()
}

/// The request numbers differ on this architecture, and nobody has tried them.
#[cfg(not(any(
    target_arch = "x86_64",
    target_arch = "x86",
    target_arch = "aarch64",
    target_arch = "arm",
    target_arch = "riscv64"
)))]
pub(super) fn set(_fd: BorrowedFd<'_>) -> bool {
    false
}

#[cfg(any(
    target_arch = "x86_64",
    target_arch = "x86",
    target_arch = "aarch64",
    target_arch = "arm",
    target_arch = "riscv64"
))]
mod kernel {
    //! From Linux's include/uapi: `asm-generic/ioctls.h`, `linux/serial.h`, `linux/tty_flags.h`.

    use std::ffi::{c_char, c_int, c_uchar, c_uint, c_ulong, c_ushort};

    use rustix::ioctl::Opcode;

    pub(super) const TIOCGSERIAL: Opcode = 0x541E;
    pub(super) const TIOCSSERIAL: Opcode = 0x541F;
    pub(super) const ASYNC_LOW_LATENCY: c_int = 1 << 13;

    /// `struct serial_struct`.
    #[repr(C)]
    pub(super) struct Serial {
        kind: c_int,
        line: c_int,
        port: c_uint,
        irq: c_int,
        pub(super) flags: c_int,
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

    #[cfg(target_pointer_width = "64")]
    const _: () = assert!(size_of::<Serial>() == 72);
    #[cfg(target_pointer_width = "32")]
    const _: () = assert!(size_of::<Serial>() == 60);
}
