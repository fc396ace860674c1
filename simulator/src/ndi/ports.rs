//! Port handles: tools that are plugged in, and those that a host loads.

/// Bytes of a tool's definition: sixteen pages of 64.
const ROM_BYTES: usize = 1024;

/// Bytes that `PVWR` writes at once.
pub(super) const PAGE_BYTES: usize = 64;

/// Where a definition has the part number, and how long it is.
const PART_NUMBER: std::ops::Range<usize> = 592..612;

/// Handles that a host may ask for beside the tools that are plugged in.
const LOADED_MAX: usize = 32;

/// One handle.
#[derive(Debug, Clone)]
pub(super) struct Port {
    pub(super) handle: u8,
    /// The column of the motion that the tool is; `None` when it is never seen.
    pub(super) column: Option<usize>,
    pub(super) part_number: String,
    pub(super) initialized: bool,
    pub(super) enabled: bool,
    /// The definition that a host loaded; `None` for a tool that is plugged in.
    rom: Option<Box<[u8; ROM_BYTES]>>,
    pub(super) written: bool,
}

impl Port {
    /// Bits: occupied (1), initialized (16), enabled (32).
    pub(super) fn status(&self) -> u32 {
        1 | u32::from(self.initialized) << 4 | u32::from(self.enabled) << 5
    }

    /// `false` when the page lies outside the definition, or the tool is plugged in.
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
    /// Tools that are plugged in: their part numbers and columns.
    pub(super) fn new(tools: Vec<(String, usize)>, n_columns: usize) -> Self {
        let port = |(handle, (part_number, column))| Port {
            handle,
            column: Some(column),
            part_number,
            initialized: false,
            enabled: false,
            rom: None,
            written: true,
        };
        Self { ports: (1..).zip(tools).map(port).collect(), n_columns }
    }

    /// As after power-on: what was loaded is gone.
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

    /// A handle for a tool that will be loaded: the first marker that is no tool yet plays it.
    pub(super) fn request(&mut self) -> Option<u8> {
        let loaded = self.ports.iter().filter(|port| port.rom.is_some()).count();
        if loaded >= LOADED_MAX {
            return None;
        }
        let handle = (0x0A..=0xFE).find(|handle| self.ports.iter().all(|p| p.handle != *handle))?;
        let column = (0..self.n_columns)
            .find(|column| self.ports.iter().all(|port| port.column != Some(*column)));
        self.ports.push(Port {
            handle,
            column,
            part_number: String::new(),
            initialized: false,
            enabled: false,
            rom: Some(Box::new([0; ROM_BYTES])),
            written: false,
        });
        self.ports.sort_by_key(|port| port.handle);
        Some(handle)
    }

    /// `false` when there is no such handle. A tool that is plugged in keeps its own.
    pub(super) fn free(&mut self, handle: u8) -> bool {
        let before = self.ports.len();
        self.ports.retain(|port| port.handle != handle || port.rom.is_none());
        before > self.ports.len() || self.ports.iter().any(|port| port.handle == handle)
    }

    /// Whether the marker of a column is reported as a tool.
    pub(super) fn is_tool(&self, column: usize) -> bool {
        self.enabled().any(|port| port.column == Some(column))
    }
}
