//! Commands that set the system up, and the port handles on which most of them act.

use mocapd_drivers::ndi::{BAUD_AT_RESET, BAUDS, code};

use super::{Answer, NdiDevice};

/// The answer without data.
const OKAY: &str = "OKAY";

/// Commands that are allowed before `INIT`.
const ALWAYS: [&str; 7] = ["INIT", "RESET", "ECHO", "VER", "APIREV", "GETINFO", "COMM"];

/// Commands that are not allowed in tracking mode.
const SETUP_ONLY: [&str; 9] =
    ["COMM", "PHRQ", "PHF", "PVWR", "PINIT", "PENA", "PDIS", "SET", "TSTART"];

impl NdiDevice {
    /// Executes a command; returns the answer without its checksum, or the error code.
    pub(super) fn execute(&mut self, name: &str, args: &str) -> Answer {
        if !self.initialized && !ALWAYS.contains(&name) {
            return Err(code::NOT_INITIALIZED);
        }
        if self.is_running() && SETUP_ONLY.contains(&name) {
            return Err(code::WRONG_MODE);
        }
        match name {
            "INIT" => {
                self.reset();
                self.initialized = true;
                Ok(OKAY.to_owned())
            }
            "RESET" => {
                self.baud_after = Some(BAUD_AT_RESET);
                self.reset();
                Ok("RESET".to_owned())
            }
            "ECHO" => Ok(args.to_owned()),
            "BEEP" if matches!(args.parse(), Ok(1..=9)) => Ok("1".to_owned()),
            "BEEP" => Err(code::OUT_OF_RANGE),
            "VER" => self.version(args),
            "APIREV" => Ok(if self.settings.bx2 { "G.003.005" } else { "D.001.007" }.to_owned()),
            "GETINFO" => self.parameter(args).map(|(value, rest)| format!("{args}={value};{rest}")),
            "GET" => self.parameter(args).map(|(value, _)| format!("{args}={value}")),
            "SET" => self.set(args),
            "COMM" => self.comm(args),
            "PHSR" => self.list(args),
            "PHRQ" => Ok(format!("{:02X}", self.ports.request().ok_or(code::ALL_PORTS_TAKEN)?)),
            "PHF" => {
                self.ports.free(handle(args)?).then(|| OKAY.to_owned()).ok_or(code::NO_SUCH_HANDLE)
            }
            "PVWR" => self.write_rom(args),
            "PINIT" => self.initialize(handle(args)?),
            "PENA" => self.enable(args),
            "PDIS" => {
                self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?.enabled = false;
                Ok(OKAY.to_owned())
            }
            "PHINF" => self.info(args),
            _ => Err(code::INVALID_COMMAND),
        }
    }

    fn version(&self, args: &str) -> Answer {
        let firmware = env!("CARGO_PKG_VERSION");
        match args {
            "0" | "1" | "2" | "3" | "4" | "5" | "7" | "8" => Ok(format!(
                "mocapd-sim Control Firmware\nNDI S/N: {}\nCharacterization Date: 01/01/26\n\
                 Freeze Tag: mocapd-sim {firmware}\nFreeze Date : 01/01/26\n",
                self.settings.serial
            )),
            _ => Err(code::OUT_OF_RANGE),
        }
    }

    /// The value of a parameter, and the rest of the answer to `GETINFO`: type, attributes, range, names, description.
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
                let rate_hz = f64::from(self.rate_millihertz()) / 1000.0;
                Ok((rate_hz.to_string(), "1;3;1;10000;;Frames a second"))
            }
            "Param.Tracking.Track Frequency" => {
                Ok(("2".to_owned(), "1;3;0;2;;Tracked frames: every third, second, or each"))
            }
            _ => Err(code::OUT_OF_RANGE),
        }
    }

    /// Accepts the current value only; every other value is out of range.
    fn set(&self, args: &str) -> Answer {
        let (name, value) = args.split_once('=').ok_or(code::PARAMETERS)?;
        let (known, _) = self.parameter(name)?;
        if known == value { Ok(OKAY.to_owned()) } else { Err(code::OUT_OF_RANGE) }
    }

    /// `bdddh`: speed, data bits with parity and stop bits, handshake.
    fn comm(&mut self, args: &str) -> Answer {
        let digit = args.chars().next().ok_or(code::PARAMETERS)?;
        let (baud, _) = BAUDS.into_iter().find(|(_, d)| *d == digit).ok_or(code::COMM_FAILED)?;
        match args.get(1..) {
            Some("0000" | "0001") if baud <= self.settings.baud_max => {
                self.baud_after = Some(baud);
                Ok(OKAY.to_owned())
            }
            Some(rest) if rest.len() == 4 => Err(code::COMM_FAILED),
            _ => Err(code::PARAMETERS),
        }
    }

    /// Lists handles: all (0), to be freed (1), not initialized (2), not enabled (3), enabled (4).
    fn list(&self, args: &str) -> Answer {
        let is_listed = |port: &&Port| match args {
            "00" | "" => true,
            "02" => !port.initialized,
            "03" => port.initialized && !port.enabled,
            "04" => port.enabled,
            _ => false,
        };
        if !["", "00", "01", "02", "03", "04"].contains(&args) {
            return Err(code::PARAMETERS);
        }
        let ports: Vec<_> = self.ports.iter().filter(is_listed).collect();
        let mut text = format!("{:02X}", ports.len());
        for port in ports {
            text.push_str(&format!("{:02X}{:03X}", port.handle, port.status()));
        }
        Ok(text)
    }

    /// Writes a page of a tool definition: `hhaaaa` and 64 bytes in hexadecimal.
    fn write_rom(&mut self, args: &str) -> Answer {
        let port = self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?;
        let address = args.get(2..6).and_then(|a| usize::from_str_radix(a, 16).ok());
        let digits = args.get(6..).filter(|digits| digits.len() == 2 * PAGE_BYTES);
        let (Some(address), Some(digits)) = (address, digits) else { return Err(code::PARAMETERS) };
        let mut page = [0; PAGE_BYTES];
        for (at, byte) in page.iter_mut().enumerate() {
            let two = digits.get(2 * at..2 * at + 2).ok_or(code::PARAMETERS)?;
            *byte = u8::from_str_radix(two, 16).map_err(|_| code::PARAMETERS)?;
        }
        if port.write(address, &page) { Ok(OKAY.to_owned()) } else { Err(code::OUT_OF_RANGE) }
    }

    fn initialize(&mut self, handle: u8) -> Answer {
        let port = self.ports.get(handle).ok_or(code::INVALID_PORT)?;
        if !port.written {
            return Err(code::NO_TOOL);
        }
        port.initialized = true;
        Ok(OKAY.to_owned())
    }

    /// Enables a tool: `hhm`, where the priority is static, dynamic or button box.
    fn enable(&mut self, args: &str) -> Answer {
        let port = self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?;
        match args.get(2..) {
            Some("S" | "D" | "B") if port.initialized => {
                port.enabled = true;
                Ok(OKAY.to_owned())
            }
            Some("S" | "D" | "B") => Err(code::PORT_NOT_INITIALIZED),
            _ => Err(code::INVALID_PRIORITY),
        }
    }

    fn info(&mut self, args: &str) -> Answer {
        let port = self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?;
        let mode = mode(args.get(2..).unwrap_or_default())?;
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
    let digits = args.get(..2).ok_or(code::PARAMETERS)?;
    u8::from_str_radix(digits, 16).map_err(|_| code::PARAMETERS)
}

/// Size of a tool definition: sixteen pages of 64 bytes.
const ROM_BYTES: usize = 1024;

/// Size of a page, which one `PVWR` writes.
pub(super) const PAGE_BYTES: usize = 64;

/// The part number's bytes in a tool definition.
const PART_NUMBER: std::ops::Range<usize> = 592..612;

/// Maximum number of handles that a host may request in addition to the tools that are plugged in.
const LOADED_MAX: usize = 32;

/// A port handle and its tool.
#[derive(Debug, Clone, Default)]
pub(super) struct Port {
    pub(super) handle: u8,
    /// The tool's column in the motion; `None` when it is never visible.
    pub(super) column: Option<usize>,
    pub(super) part_number: String,
    pub(super) initialized: bool,
    pub(super) enabled: bool,
    /// The tool definition loaded by a host; `None` for a tool that is plugged in.
    rom: Option<Box<[u8; ROM_BYTES]>>,
    pub(super) written: bool,
}

impl Port {
    /// Status bits: occupied (1), initialized (16), enabled (32).
    pub(super) fn status(&self) -> u32 {
        1 | u32::from(self.initialized) << 4 | u32::from(self.enabled) << 5
    }

    /// Writes a page; `false` when it lies outside the definition, or the tool is plugged in.
    pub(super) fn write(&mut self, address: usize, page: &[u8; PAGE_BYTES]) -> bool {
        let Some(rom) = &mut self.rom else { return false };
        let Some(place) = rom.get_mut(address..).and_then(|rest| rest.get_mut(..PAGE_BYTES)) else {
            return false;
        };
        place.copy_from_slice(page);
        self.written = true;
        let text = rom.get(PART_NUMBER).unwrap_or_default();
        let printable = text.iter().take_while(|byte| (b' '..=b'~').contains(*byte));
        self.part_number = printable.map(|byte| char::from(*byte)).collect();
        true
    }
}

/// All handles, in ascending order.
#[derive(Debug)]
pub(super) struct Ports {
    ports: Vec<Port>,
    n_columns: usize,
}

impl Ports {
    /// Creates the handles of the tools that are plugged in, from their part numbers and columns.
    pub(super) fn new(tools: Vec<(String, usize)>, n_columns: usize) -> Self {
        let port = |(handle, (part_number, column))| Port {
            handle,
            column: Some(column),
            part_number,
            written: true,
            ..Port::default()
        };
        Self { ports: (1..).zip(tools).map(port).collect(), n_columns }
    }

    /// Restores the state after power-on: loaded tools are gone.
    pub(super) fn reset(&mut self) {
        self.ports.retain(|port| port.rom.is_none());
        for port in &mut self.ports {
            (port.initialized, port.enabled) = (false, false);
        }
    }

    pub(super) fn get(&mut self, handle: u8) -> Option<&mut Port> {
        self.ports.iter_mut().find(|port| port.handle == handle)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Port> {
        self.ports.iter()
    }

    pub(super) fn enabled(&self) -> impl Iterator<Item = &Port> {
        self.ports.iter().filter(|port| port.enabled)
    }

    /// Creates a handle for a tool to be loaded; the first marker that is not a tool yet acts as this tool.
    pub(super) fn request(&mut self) -> Option<u8> {
        let loaded = self.ports.iter().filter(|port| port.rom.is_some()).count();
        if loaded >= LOADED_MAX {
            return None;
        }
        let handle = (0x0A..=0xFE).find(|handle| self.ports.iter().all(|p| p.handle != *handle))?;
        let column = (0..self.n_columns)
            .find(|column| self.ports.iter().all(|port| port.column != Some(*column)));
        let rom = Some(Box::new([0; ROM_BYTES]));
        self.ports.push(Port { handle, column, rom, ..Port::default() });
        self.ports.sort_by_key(|port| port.handle);
        Some(handle)
    }

    /// Frees the handle of a loaded tool; a tool that is plugged in keeps its own. `false` when there is no such
    /// handle.
    pub(super) fn free(&mut self, handle: u8) -> bool {
        let before = self.ports.len();
        self.ports.retain(|port| port.handle != handle || port.rom.is_none());
        before > self.ports.len() || self.ports.iter().any(|port| port.handle == handle)
    }

    /// Whether the marker in this column is reported as a tool.
    pub(super) fn is_tool(&self, column: usize) -> bool {
        self.enabled().any(|port| port.column == Some(column))
    }
}

/// Parses reply options, four hexadecimal digits; the default is transforms and status.
pub(super) fn mode(args: &str) -> Result<u16, u8> {
    match args {
        "" => Ok(1),
        digits => u16::from_str_radix(digits, 16).map_err(|_| code::PARAMETERS),
    }
}
