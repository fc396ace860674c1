//! Commands that are not about frames.

use mocapd_drivers::ndi::{BAUD_AT_RESET, BAUDS};

use super::{NdiDevice, ports::PAGE_BYTES, request::INVALID};

/// Errors, as `ERRORxx` has them.
const COMM_FAILED: u8 = 0x06;
const PARAMETERS: u8 = 0x07;
const INVALID_PORT: u8 = 0x08;
const INVALID_PRIORITY: u8 = 0x09;
pub(super) const WRONG_MODE: u8 = 0x0C;
const NO_TOOL: u8 = 0x0D;
const NOT_INITIALIZED_PORT: u8 = 0x0E;
const NOT_INITIALIZED: u8 = 0x10;
const OUT_OF_RANGE: u8 = 0x23;
const ALL_TAKEN: u8 = 0x2D;
const NO_SUCH_HANDLE: u8 = 0x2B;

/// The answer when there is nothing to say.
const OKAY: &str = "OKAY";

/// Commands that work before `INIT`.
const ALWAYS: [&str; 7] = ["INIT", "RESET", "ECHO", "VER", "APIREV", "GETINFO", "COMM"];

/// Commands that do not work while it tracks.
const SETUP_ONLY: [&str; 9] =
    ["COMM", "PHRQ", "PHF", "PVWR", "PINIT", "PENA", "PDIS", "SET", "TSTART"];

impl NdiDevice {
    /// The answer to a command, without its checksum, or the error's number.
    pub(super) fn obey(&mut self, name: &str, args: &str) -> Result<String, u8> {
        if !self.initialized && !ALWAYS.contains(&name) {
            return Err(NOT_INITIALIZED);
        }
        if self.is_running() && SETUP_ONLY.contains(&name) {
            return Err(WRONG_MODE);
        }
        match name {
            "INIT" => {
                self.set_up_anew();
                self.initialized = true;
                Ok(OKAY.to_owned())
            }
            "RESET" => {
                self.baud_after = Some(BAUD_AT_RESET);
                self.set_up_anew();
                Ok("RESET".to_owned())
            }
            "ECHO" => Ok(args.to_owned()),
            "BEEP" => match args.parse() {
                Ok(1..=9) => Ok("1".to_owned()),
                _ => Err(OUT_OF_RANGE),
            },
            "VER" => self.version(args),
            "APIREV" => Ok(if self.settings.bx2 { "G.003.005" } else { "D.001.007" }.to_owned()),
            "GETINFO" => self.parameter(args).map(|(value, rest)| format!("{args}={value};{rest}")),
            "GET" => self.parameter(args).map(|(value, _)| format!("{args}={value}")),
            "SET" => self.set(args),
            "COMM" => self.comm(args),
            "PHSR" => self.list(args),
            "PHRQ" => self.ports.request().map(|handle| format!("{handle:02X}")).ok_or(ALL_TAKEN),
            "PHF" => self.ports.free(handle(args)?).then(|| OKAY.to_owned()).ok_or(NO_SUCH_HANDLE),
            "PVWR" => self.write_rom(args),
            "PINIT" => self.initialize(handle(args)?),
            "PENA" => self.enable(args),
            "PDIS" => {
                self.ports.get(handle(args)?).ok_or(INVALID_PORT)?.enabled = false;
                Ok(OKAY.to_owned())
            }
            "PHINF" => self.info(args),
            _ => Err(INVALID),
        }
    }

    fn version(&self, args: &str) -> Result<String, u8> {
        let firmware = env!("CARGO_PKG_VERSION");
        match args {
            "0" | "1" | "2" | "3" | "4" | "5" | "7" | "8" => Ok(format!(
                "mocapd-sim Control Firmware\nNDI S/N: {}\nCharacterization Date: 01/01/26\n\
                 Freeze Tag: mocapd-sim {firmware}\nFreeze Date : 01/01/26\n",
                self.settings.serial
            )),
            _ => Err(OUT_OF_RANGE),
        }
    }

    /// Its value, and what else `GETINFO` says: type, attributes, range, names, a description.
    fn parameter(&self, name: &str) -> Result<(String, &'static str), u8> {
        match name {
            "Features.Firmware.Version" => Ok((
                env!("CARGO_PKG_VERSION").to_owned(),
                "3;1;0;12;;Current firmware revision number, of a simulator",
            )),
            "Features.Hardware.Serial Number" => {
                Ok((self.settings.serial.clone(), "3;1;0;12;;Serial number"))
            }
            "Param.Tracking.Frame Frequency" => {
                let rate_hz = f64::from(self.rate_mhz()) / 1000.0;
                Ok((rate_hz.to_string(), "1;3;1;10000;;Frames a second"))
            }
            "Param.Tracking.Track Frequency" => {
                Ok(("2".to_owned(), "1;3;0;2;;Tracked frames: every third, second, or each"))
            }
            _ => Err(OUT_OF_RANGE),
        }
    }

    /// What is set already may be set; anything else is out of range.
    fn set(&self, args: &str) -> Result<String, u8> {
        let (name, value) = args.split_once('=').ok_or(PARAMETERS)?;
        let (known, _) = self.parameter(name)?;
        if known == value { Ok(OKAY.to_owned()) } else { Err(OUT_OF_RANGE) }
    }

    /// `bdddh`: speed, data bits with parity and stop bits, handshake.
    fn comm(&mut self, args: &str) -> Result<String, u8> {
        let digit = args.chars().next().ok_or(PARAMETERS)?;
        let (baud, _) = BAUDS.into_iter().find(|(_, d)| *d == digit).ok_or(COMM_FAILED)?;
        match args.get(1..) {
            Some("0000" | "0001") if baud <= self.settings.baud_max => {
                self.baud_after = Some(baud);
                Ok(OKAY.to_owned())
            }
            Some(rest) if rest.len() == 4 => Err(COMM_FAILED),
            _ => Err(PARAMETERS),
        }
    }

    /// Handles: all (0), to be freed (1), not initialized (2), not enabled (3), enabled (4).
    fn list(&self, args: &str) -> Result<String, u8> {
        let wanted = |port: &&super::ports::Port| match args {
            "00" | "" => true,
            "02" => !port.initialized,
            "03" => port.initialized && !port.enabled,
            "04" => port.enabled,
            _ => false,
        };
        if !["", "00", "01", "02", "03", "04"].contains(&args) {
            return Err(PARAMETERS);
        }
        let ports: Vec<_> = self.ports.iter().filter(wanted).collect();
        let mut text = format!("{:02X}", ports.len());
        for port in ports {
            text.push_str(&format!("{:02X}{:03X}", port.handle, port.status()));
        }
        Ok(text)
    }

    /// `hhaaaa` and 64 bytes in hexadecimal.
    fn write_rom(&mut self, args: &str) -> Result<String, u8> {
        let port = self.ports.get(handle(args)?).ok_or(INVALID_PORT)?;
        let address = args.get(2..6).and_then(|a| usize::from_str_radix(a, 16).ok());
        let digits = args.get(6..).filter(|digits| digits.len() == 2 * PAGE_BYTES);
        let (Some(address), Some(digits)) = (address, digits) else { return Err(PARAMETERS) };
        let mut page = [0; PAGE_BYTES];
        for (at, byte) in page.iter_mut().enumerate() {
            let two = digits.get(2 * at..2 * at + 2).ok_or(PARAMETERS)?;
            *byte = u8::from_str_radix(two, 16).map_err(|_| PARAMETERS)?;
        }
        if port.write(address, &page) { Ok(OKAY.to_owned()) } else { Err(OUT_OF_RANGE) }
    }

    fn initialize(&mut self, handle: u8) -> Result<String, u8> {
        let port = self.ports.get(handle).ok_or(INVALID_PORT)?;
        if !port.written {
            return Err(NO_TOOL);
        }
        port.initialized = true;
        Ok(OKAY.to_owned())
    }

    /// `hhm`: the priority is static, dynamic or button box.
    fn enable(&mut self, args: &str) -> Result<String, u8> {
        let port = self.ports.get(handle(args)?).ok_or(INVALID_PORT)?;
        match args.get(2..) {
            Some("S" | "D" | "B") if port.initialized => {
                port.enabled = true;
                Ok(OKAY.to_owned())
            }
            Some("S" | "D" | "B") => Err(NOT_INITIALIZED_PORT),
            _ => Err(INVALID_PRIORITY),
        }
    }

    fn info(&mut self, args: &str) -> Result<String, u8> {
        let port = self.ports.get(handle(args)?).ok_or(INVALID_PORT)?;
        let mode = match args.get(2..) {
            Some("") | None => 1,
            Some(digits) => u16::from_str_radix(digits, 16).map_err(|_| PARAMETERS)?,
        };
        let (handle, status, part) = (port.handle, port.status(), &port.part_number);
        let mut text = String::new();
        for (bit, field) in [
            (0x01, format!("02000000{:<12}001{handle:08X}{status:02X}", "mocapd-sim")),
            (0x02, "00000000".to_owned()),
            (0x04, format!("{part:<20}")),
            (0x08, "00".to_owned()),
            (0x10, "29".to_owned()),
            (0x20, format!("SIM0001 00{handle:02X}00")),
            (0x40, "00".to_owned()),
        ] {
            if mode & bit != 0 {
                text.push_str(&field);
            }
        }
        Ok(text)
    }
}

fn handle(args: &str) -> Result<u8, u8> {
    let digits = args.get(..2).ok_or(PARAMETERS)?;
    u8::from_str_radix(digits, 16).map_err(|_| PARAMETERS)
}
