//! `devices`: what is attached, which driver claims it, or why it cannot be opened.

use mocapd::outcome::Outcome;
use mocapd_drivers::{
    registry::{self, Claim, Listed},
    transport::Access,
};
use serde::Serialize;

use super::output::{plain, print, print_json};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    device: String,
    manufacturer: Option<String>,
    product: Option<String>,
    serial: Option<String>,
    driver: Option<&'static str>,
    certain: bool,
    problem: Option<String>,
}

impl From<Listed> for Report {
    fn from(listed: Listed) -> Self {
        Self {
            device: listed.candidate.location.to_string(),
            manufacturer: listed.candidate.manufacturer,
            product: listed.candidate.product,
            serial: listed.candidate.serial,
            driver: listed.family.map(|family| family.0),
            certain: listed.family.is_some_and(|family| family.1 == Claim::Certain),
            problem: match listed.access {
                Access::Accessible => None,
                Access::Refused(error) => Some(error.to_string()),
            },
        }
    }
}

impl Report {
    /// One line, and a second one for what is in the way.
    fn words(&self) -> String {
        let driver = match (self.driver, self.certain) {
            (Some(driver), true) => driver.to_owned(),
            (Some(driver), false) => format!("perhaps {driver}"),
            (None, _) => "no driver".to_owned(),
        };
        let names = [&self.manufacturer, &self.product, &self.serial];
        let names: Vec<&str> = names.into_iter().flatten().map(String::as_str).collect();
        let line = format!("{:<32} {driver:<14} {}", self.device, names.join(" "));
        let mut out = format!("{}\n", plain(line.trim_end()));
        if let Some(problem) = &self.problem {
            out += &format!("    {}\n", plain(problem));
        }
        out
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let reports: Vec<Report> = registry::devices()?.into_iter().map(Report::from).collect();
    if args.json {
        print_json(&reports)?;
    } else if reports.is_empty() {
        print("no devices: plug one in, or try `mocapd demo`, which needs none\n")?;
    } else {
        print(&reports.iter().map(Report::words).collect::<String>())?;
    }
    Ok(Outcome::Done)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter() -> Report {
        Report {
            device: "serial:/dev/ttyUSB0".to_owned(),
            manufacturer: Some("FTDI".to_owned()),
            product: Some("FT232R\x1b[2J".to_owned()),
            serial: None,
            driver: Some("dvmc"),
            certain: false,
            problem: Some("no permission".to_owned()),
        }
    }

    #[test]
    fn says_what_is_sure_and_what_is_in_the_way() {
        let words = adapter().words();
        assert!(words.starts_with("serial:/dev/ttyUSB0 "), "{words}");
        assert!(words.contains("perhaps dvmc") && words.contains("FTDI FT232R\u{fffd}[2J\n"));
        assert!(words.ends_with("\n    no permission\n"), "{words}");
        let sure = Report { certain: true, problem: None, ..adapter() };
        assert!(!sure.words().contains("perhaps") && sure.words().lines().count() == 1);
    }

    #[test]
    fn the_document_has_its_fields() {
        let document = include_str!("../../docs/json.md");
        let serde_json::Value::Object(fields) = serde_json::to_value(adapter()).unwrap() else {
            panic!("a report is an object");
        };
        for name in fields.keys() {
            assert!(
                document.contains(&format!("| `[].{name}` |")),
                "{name} is not in docs/json.md"
            );
        }
    }
}
