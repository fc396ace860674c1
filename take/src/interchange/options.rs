//! How a file is to be read where it does not say, or says wrong.

use super::{
    notes::Notes,
    turn::{Direction, Turn},
    units::LengthUnit,
};
use crate::motion::UpAxis;

/// Names of the settings that a take's header keeps of them.
const UNIT: &str = "unit";
const UP: &str = "up";

/// What is known of a file beside what stands in it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// The unit of length, instead of the file's own.
    pub unit: Option<LengthUnit>,
    /// What points up, instead of what the file says. Where that is the way down an axis, positions are given half a
    /// turn, so that the axis points up.
    pub up: Option<Direction>,
}

impl ReadOptions {
    /// As a header keeps them.
    #[must_use]
    pub fn settings(&self) -> Vec<(String, String)> {
        let unit = self.unit.map(|unit| (UNIT.to_owned(), unit.to_string()));
        let up = self.up.map(|up| (UP.to_owned(), up.to_string()));
        unit.into_iter().chain(up).collect()
    }

    /// Those that a take was imported with.
    #[must_use]
    pub fn from_settings(settings: &[(String, String)]) -> Self {
        let value = |name: &str| {
            settings.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
        };
        Self {
            unit: value(UNIT).and_then(|unit| unit.parse().ok()),
            up: value(UP).and_then(|up| up.parse().ok()),
        }
    }

    /// How positions are turned.
    pub(super) fn turn(&self) -> Turn {
        match self.up {
            Some(up) if up.is_negative() => Turn::upside_down(up.axis()),
            _ => Turn::NONE,
        }
    }

    /// Which axis is up after that; what the file says is noted where it is another.
    pub(super) fn up(&self, of_file: UpAxis, notes: &mut Notes) -> UpAxis {
        let Some(up) = self.up else { return of_file };
        if let Some(name) = of_file.name().filter(|_| of_file != up.axis() || up.is_negative()) {
            notes
                .warnings
                .push(format!("The file says that {name} is up; {up} was taken, as asked."));
        }
        if up.is_negative() {
            notes.warnings.push(format!(
                "Positions were given half a turn, as asked, so that {} is up.",
                up.axis().name().unwrap_or("it")
            ));
        }
        up.axis()
    }
}
