//! `devices`: what is attached, which driver claims it, or why it cannot be opened.

use mocapd::outcome::Outcome;
use mocapd_drivers::{
    registry::{self, Claim, Listed},
    transport::Access,
};
use serde::Serialize;

use super::output::{print, print_json};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    device: String,
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

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let reports: Vec<Report> = registry::devices()?.into_iter().map(Report::from).collect();
    if args.json {
        print_json(&reports)?;
        return Ok(Outcome::Done);
    }
    if reports.is_empty() {
        print("no devices: plug one in, or try `mocapd demo`, which needs none\n")?;
    }
    for report in &reports {
        let driver = match (report.driver, report.certain) {
            (Some(driver), true) => driver.to_owned(),
            (Some(driver), false) => format!("{driver}?"),
            (None, _) => "-".to_owned(),
        };
        let product = report.product.as_deref().unwrap_or("");
        let serial = report.serial.as_deref().unwrap_or("");
        print(&format!("{:<32} {driver:<8} {product} {serial}\n", report.device))?;
        if let Some(problem) = &report.problem {
            print(&format!("    {problem}\n"))?;
        }
    }
    Ok(Outcome::Done)
}
