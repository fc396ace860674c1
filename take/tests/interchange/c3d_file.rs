//! Builds C3D files byte by byte, independently of the product's writer.

/// Byte order of a file to build.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    Intel,
    Dec,
    Mips,
}

impl Order {
    pub(crate) fn word(self, value: u16) -> [u8; 2] {
        if self == Self::Mips { value.to_be_bytes() } else { value.to_le_bytes() }
    }

    /// A float; a VAX float is the IEEE one times four with its words swapped.
    pub(crate) fn float(self, value: f32) -> [u8; 4] {
        match self {
            Self::Intel => value.to_le_bytes(),
            Self::Mips => value.to_be_bytes(),
            Self::Dec => {
                let [b0, b1, b2, b3] = (value * 4.0).to_le_bytes();
                [b2, b3, b0, b1]
            }
        }
    }
}

/// A file to build: by default Intel floats in millimetres at 100 Hz.
#[derive(Debug, Clone)]
pub(crate) struct C3dFile {
    pub(crate) order: Order,
    /// Negative: floats.
    pub(crate) scale: f32,
    pub(crate) unit: &'static str,
    pub(crate) n_points: usize,
    /// Frames of four words per point, then the analog samples.
    pub(crate) frames: Vec<Vec<f32>>,
    pub(crate) analog: (usize, usize),
    pub(crate) first_last: (u16, u16),
    /// Parameter records after those of POINT, which every file has.
    pub(crate) records: Vec<u8>,
}

impl C3dFile {
    /// Points without analog samples.
    pub(crate) fn new(n_points: usize, frames: Vec<Vec<f32>>) -> Self {
        let last = u16::try_from(frames.len()).unwrap_or(u16::MAX);
        Self {
            order: Order::Intel,
            scale: -1.0,
            unit: "mm",
            n_points,
            frames,
            analog: (0, 0),
            first_last: (1, last),
            records: Vec::new(),
        }
    }

    /// The bytes of a parameter record.
    pub(crate) fn record(
        &self,
        group: i8,
        name: &str,
        kind: i8,
        dimensions: &[u8],
        data: &[u8],
    ) -> Vec<u8> {
        let mut record = vec![name.len() as u8, group as u8];
        record.extend(name.as_bytes());
        record.extend(self.order.word((2 + 1 + 1 + dimensions.len() + data.len() + 1) as u16));
        record.extend([kind as u8, dimensions.len() as u8]);
        record.extend(dimensions);
        record.extend(data);
        record.push(0);
        record
    }

    /// The bytes of a group record.
    pub(crate) fn group(&self, id: i8, name: &str) -> Vec<u8> {
        let mut record = vec![name.len() as u8, -id as u8];
        record.extend(name.as_bytes());
        record.extend(self.order.word(3));
        record.push(0);
        record
    }

    /// Adds a list of texts, all as long as the longest.
    pub(crate) fn texts(&mut self, group: i8, name: &str, texts: &[&str]) {
        let length = texts.iter().map(|t| t.len()).max().unwrap_or(0);
        let data: Vec<u8> =
            texts.iter().flat_map(|t| format!("{t:length$}").into_bytes()).collect();
        let record = self.record(group, name, -1, &[length as u8, texts.len() as u8], &data);
        self.records.extend(record);
    }

    /// Adds 16-bit words.
    pub(crate) fn words(&mut self, group: i8, name: &str, words: &[u16]) {
        let data: Vec<u8> = words.iter().flat_map(|&w| self.order.word(w)).collect();
        let dimensions = if words.len() == 1 { vec![] } else { vec![words.len() as u8] };
        let record = self.record(group, name, 2, &dimensions, &data);
        self.records.extend(record);
    }

    /// Adds floats.
    pub(crate) fn floats(&mut self, group: i8, name: &str, floats: &[f32]) {
        let data: Vec<u8> = floats.iter().flat_map(|&f| self.order.float(f)).collect();
        let dimensions = if floats.len() == 1 { vec![] } else { vec![floats.len() as u8] };
        let record = self.record(group, name, 4, &dimensions, &data);
        self.records.extend(record);
    }

    /// The file.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        let order = self.order;
        let mut section = self.group(1, "POINT");
        section.extend(self.record(1, "USED", 2, &[], &order.word(self.n_points as u16)));
        section.extend(self.record(1, "SCALE", 4, &[], &order.float(self.scale)));
        section.extend(self.record(1, "RATE", 4, &[], &order.float(100.0)));
        section.extend(self.record(1, "UNITS", -1, &[self.unit.len() as u8], self.unit.as_bytes()));
        section.extend(&self.records);
        section.extend([0, 0]);
        let n_blocks = (section.len() + 4).div_ceil(512);
        let (n_channels, ratio) = self.analog;
        let mut bytes = vec![2, 0x50];
        for word in [
            self.n_points,
            n_channels * ratio,
            self.first_last.0 as usize,
            self.first_last.1 as usize,
            10,
        ] {
            bytes.extend(order.word(word as u16));
        }
        bytes.extend(order.float(self.scale));
        bytes.extend(order.word((n_blocks + 2) as u16));
        bytes.extend(order.word(ratio as u16));
        bytes.extend(order.float(100.0));
        bytes.resize(512, 0);
        let code = match order {
            Order::Intel => 84,
            Order::Dec => 85,
            Order::Mips => 86,
        };
        bytes.extend([1, 0x50, n_blocks as u8, code]);
        bytes.extend(section);
        bytes.resize(512 * (n_blocks + 1), 0);
        for value in self.frames.iter().flatten() {
            if self.scale < 0.0 {
                bytes.extend(order.float(*value));
            } else {
                bytes.extend(order.word(*value as i16 as u16));
            }
        }
        bytes
    }
}
