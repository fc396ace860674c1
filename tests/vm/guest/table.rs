//! The scenarios' results.

use std::time::Instant;

use crate::{Measurement, Scenario};

#[derive(Default)]
pub(crate) struct Table {
    rows: Vec<Row>,
}

struct Row {
    name: &'static str,
    result: Measurement,
    seconds: f64,
}

impl Table {
    /// Runs a scenario. `prepare` restores the initial state.
    pub(crate) fn run(
        &mut self,
        name: &'static str,
        prepare: fn() -> anyhow::Result<()>,
        scenario: Scenario,
    ) {
        println!("-- {name}");
        let started = Instant::now();
        let result = prepare().and_then(|()| scenario());
        let seconds = started.elapsed().as_secs_f64();
        match &result {
            Ok(measured) => println!("   {measured} ({seconds:.1} s)"),
            Err(error) => println!("   FAILED: {error:#} ({seconds:.1} s)"),
        }
        self.rows.push(Row { name, result, seconds });
    }

    pub(crate) fn failed(&self) -> usize {
        self.rows.iter().filter(|row| row.result.is_err()).count()
    }

    pub(crate) fn print(&self) {
        println!("\n| scenario | | s | measured |\n|---|---|---|---|");
        for Row { name, result, seconds } in &self.rows {
            let (status, text) = match result {
                Ok(measured) => ("ok", measured.clone()),
                Err(error) => ("FAILED", format!("{error:#}").replace('\n', " ")),
            };
            println!("| {name} | {status} | {seconds:.1} | {text} |");
        }
        println!("{} passed, {} failed", self.rows.len() - self.failed(), self.failed());
    }
}
