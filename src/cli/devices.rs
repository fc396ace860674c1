//! `devices`: what is attached, which driver claims it, or why it cannot be opened.

use mocapd::outcome::Outcome;
use mocapd_acquire::listing::{self, ListedDevice};

use super::output::{plain, print, print_json};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// One line, and a second one for what is in the way.
fn line(listed: &ListedDevice) -> String {
    let driver = match (&listed.driver, listed.certain) {
        (Some(driver), true) => driver.clone(),
        (Some(driver), false) => format!("perhaps {driver}"),
        (None, _) => "no driver".to_owned(),
    };
    let names = [&listed.manufacturer, &listed.product, &listed.serial];
    let names: Vec<&str> = names.into_iter().flatten().map(String::as_str).collect();
    let line = format!("{:<32} {driver:<14} {}", listed.device, names.join(" "));
    let mut out = format!("{}\n", plain(line.trim_end()));
    if let Some(problem) = &listed.problem {
        out += &format!("    {}\n", plain(problem));
    }
    out
}

/// All of them in words.
pub(super) fn words(listed: &[ListedDevice]) -> String {
    if listed.is_empty() {
        return "no devices: plug one in, or try `mocapd demo`, which needs none\n".to_owned();
    }
    listed.iter().map(line).collect()
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let listed = listing::devices()?;
    if args.json {
        print_json(&listed)?;
    } else {
        print(&words(&listed))?;
    }
    Ok(Outcome::Done)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter() -> ListedDevice {
        ListedDevice {
            device: "serial:/dev/ttyUSB0".to_owned(),
            manufacturer: Some("FTDI".to_owned()),
            product: Some("FT232R\x1b[2J".to_owned()),
            serial: None,
            driver: Some("dvmc".to_owned()),
            certain: false,
            problem: Some("no permission".to_owned()),
        }
    }

    #[test]
    fn says_what_is_sure_and_what_is_in_the_way() {
        let words = line(&adapter());
        assert!(words.starts_with("serial:/dev/ttyUSB0 "), "{words}");
        assert!(words.contains("perhaps dvmc") && words.contains("FTDI FT232R\\u{1b}[2J\n"));
        assert!(words.ends_with("\n    no permission\n"), "{words}");
        let sure = ListedDevice { certain: true, problem: None, ..adapter() };
        assert!(!line(&sure).contains("perhaps") && line(&sure).lines().count() == 1);
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
