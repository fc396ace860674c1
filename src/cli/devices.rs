//! `devices`: lists attached devices with their drivers, or why they cannot be opened, and QTM servers on the network.

use mocapd::outcome::Outcome;
use mocapd_acquire::rig::{self, ListedDevice};

use super::output::{plain, print, print_json};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// One line for a device, and a second one if it cannot be opened.
fn line(listed: &ListedDevice) -> String {
    let driver = match (&listed.driver, listed.certain) {
        (Some(driver), true) => driver.clone(),
        (Some(driver), false) => format!("{driver} (unconfirmed)"),
        (None, _) => "no driver".to_owned(),
    };
    let names = [&listed.manufacturer, &listed.product, &listed.serial];
    let names: Vec<&str> = names.into_iter().flatten().map(String::as_str).collect();
    let line = format!("{:<32} {driver:<18} {}", listed.device, names.join(" "));
    let mut out = format!("{}\n", plain(line.trim_end()));
    if let Some(problem) = &listed.problem {
        out += &format!("    {}\n", plain(problem));
    }
    out
}

/// The list as text.
pub(super) fn text(listed: &[ListedDevice]) -> String {
    if listed.is_empty() {
        return "no devices found: plug one in, give a system on the network its address as in `--device qtm:HOST`, or try `mocapd demo`, which needs none\n"
            .to_owned();
    }
    listed.iter().map(line).collect()
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let mut listed = rig::devices()?;
    listed.extend(rig::servers());
    if args.json {
        print_json(&listed)?;
    } else {
        print(&text(&listed))?;
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
    fn lines_show_unconfirmed_drivers_and_problems() {
        let text = line(&adapter());
        assert!(text.starts_with("serial:/dev/ttyUSB0 "), "{text}");
        assert!(text.contains("dvmc (unconfirmed)") && text.contains("FTDI FT232R\\u{1b}[2J\n"));
        assert!(text.ends_with("\n    no permission\n"), "{text}");
        let sure = ListedDevice { certain: true, problem: None, ..adapter() };
        assert!(!line(&sure).contains("unconfirmed") && line(&sure).lines().count() == 1);
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
