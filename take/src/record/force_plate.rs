//! The force plates of a recording: settings of its header, one for each plate.

use super::Header;
use crate::foreign::force_plate::{PlateGeometry, PlateType};

/// The key in the settings of a recording with a force plate.
const FORCE_PLATE: &str = "force_plate";

/// A force plate of a recording: where it stands, and which sampled channels are its own.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedPlate {
    /// Its number at the device, from 1.
    pub number: usize,
    /// What its channels hold.
    pub kind: PlateType,
    /// The number of the group that has its channels.
    pub group: u32,
    /// The indices of its channels in the group: six, or eight of type 3.
    pub channels: Vec<usize>,
    /// Where it is.
    pub geometry: PlateGeometry,
}

/// What a device states of a force plate.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedPlate {
    /// Its number, from 1.
    pub number: u8,
    /// The code of its type, 1 to 3.
    pub code: u8,
    /// The number of the group that has its channels.
    pub group: u32,
    /// The indices of its channels in the group.
    pub channels: Vec<usize>,
    /// Its corners.
    pub corners_mm: [[f64; 3]; 4],
    /// Its origin.
    pub origin_mm: [f64; 3],
}

impl StatedPlate {
    /// The setting of a header that states it, as key and value.
    #[must_use]
    pub fn setting(&self) -> (String, String) {
        let list =
            |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        let channels: Vec<String> = self.channels.iter().map(usize::to_string).collect();
        let text = format!(
            "number={} type={} group={} channels={} corners_mm={} origin_mm={}",
            self.number,
            self.code,
            self.group,
            channels.join(","),
            list(self.corners_mm.as_flattened()),
            list(&self.origin_mm),
        );
        (FORCE_PLATE.to_owned(), text)
    }
}

impl RecordedPlate {
    /// The plate that a device states.
    ///
    /// # Errors
    /// Why it cannot be used.
    pub fn new(stated: StatedPlate) -> Result<Self, String> {
        let StatedPlate { number, code, group, channels, corners_mm, origin_mm } = stated;
        // A calibration matrix has no place in the setting.
        let kind = PlateType::from_code(code.into()).filter(|kind| *kind != PlateType::Type4);
        let kind =
            kind.ok_or_else(|| format!("it is of type {code}, but types 1 to 3 are supported"))?;
        if channels.len() != kind.n_channels() {
            return Err(format!(
                "it has {} channels, expected {}",
                channels.len(),
                kind.n_channels()
            ));
        }
        let geometry = PlateGeometry::new(corners_mm, origin_mm)?;
        Ok(Self { number: number.into(), kind, group, channels, geometry })
    }

    /// What a device states of it.
    #[must_use]
    pub fn stated(&self) -> StatedPlate {
        StatedPlate {
            number: u8::try_from(self.number).unwrap_or(u8::MAX),
            code: self.kind.code(),
            group: self.group,
            channels: self.channels.clone(),
            corners_mm: self.geometry.corners_mm(),
            origin_mm: self.geometry.origin_mm(),
        }
    }

    fn parse(text: &str) -> Result<Self, String> {
        let of = |name: &str| {
            let mut words = text.split_whitespace().filter_map(|word| word.split_once('='));
            words.find(|(key, _)| *key == name).map(|(_, value)| value)
        };
        let field = |name: &str| of(name).ok_or_else(|| format!("it states no {name}"));
        let one = |name: &str| {
            let text = field(name)?;
            text.parse::<u8>().map_err(|_| format!("its {name} is '{text}'"))
        };
        let floats = |name: &str| numbers::<f64>(name, field(name)?);
        let (corners, origin) = (floats("corners_mm")?, floats("origin_mm")?);
        let ([corners_mm], []) = corners.as_chunks::<3>().0.as_chunks::<4>() else {
            return Err("it does not state four corners".to_owned());
        };
        let ([origin_mm], []) = origin.as_chunks::<3>() else {
            return Err("it does not state its origin".to_owned());
        };
        let channels = numbers("channels", field("channels")?)?;
        Self::new(StatedPlate {
            number: one("number")?,
            code: one("type")?,
            group: one("group")?.into(),
            channels,
            corners_mm: *corners_mm,
            origin_mm: *origin_mm,
        })
    }
}

/// The numbers of a list.
fn numbers<T: std::str::FromStr>(name: &str, text: &str) -> Result<Vec<T>, String> {
    let all = text.split(',').map(str::parse).collect::<Result<_, _>>();
    all.map_err(|_| format!("its {name} is '{text}'"))
}

impl Header {
    /// The force plates that a recording states, and why others cannot be used, one sentence each.
    #[must_use]
    pub fn force_plates(&self) -> (Vec<RecordedPlate>, Vec<String>) {
        let (mut plates, mut unusable) = (Vec::new(), Vec::new());
        for (_, text) in self.settings.iter().filter(|(key, _)| key == FORCE_PLATE) {
            match RecordedPlate::parse(text) {
                Ok(plate) => plates.push(plate),
                Err(why) => {
                    unusable.push(format!("A force plate of the take cannot be used: {why}."));
                }
            }
        }
        (plates, unusable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plate() -> StatedPlate {
        let (x, y) = (450.0, 300.5);
        StatedPlate {
            number: 2,
            code: 2,
            group: 3,
            channels: (6..12).collect(),
            corners_mm: [[x, y, 0.0], [-x, y, 0.0], [-x, -y, 0.0], [x, -y, 0.0]],
            origin_mm: [0.25, 0.0, 41.5],
        }
    }

    #[test]
    fn a_plate_round_trips_and_a_wrong_one_is_listed() {
        let good = plate().setting();
        let mut header = Header { settings: vec![good.clone()], ..Header::default() };
        assert_eq!(header.force_plates(), (vec![RecordedPlate::new(plate()).unwrap()], Vec::new()));
        for (from, to) in [
            ("channels=6,7,8,9,10,11", "channels=6,7"),
            ("type=2", "type=4"),
            ("type=2", "type=300"),
            ("origin_mm=0.25,0,41.5", "origin_mm=0.25,0"),
            ("corners_mm=450,", "corners_mm=NaN,"),
            ("group=3", "number=1"),
        ] {
            assert!(good.1.contains(from));
            header.settings[0].1 = good.1.replace(from, to);
            let (plates, unusable) = header.force_plates();
            assert_eq!((plates.len(), unusable.len()), (0, 1), "{to}");
        }
    }
}
