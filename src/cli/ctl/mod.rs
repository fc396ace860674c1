//! `ctl`: asks a running service, and tells what it answers.

mod client;
mod events;
mod words;

use std::{path::PathBuf, sync::atomic::Ordering, time::Duration};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{files::FileState, ledger::LedgerDocument, listing::ListedDevice};
use mocapd_service::{
    control::{Marked, Started, Stopped},
    status::{Status, TakeSummary},
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use self::client::{Client, Target};
use crate::cli::{
    devices, ledger,
    output::{print, print_json, print_json_text, say},
    stop::stop_on_signal,
    values,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Where the service listens
    ///
    /// Without it `$MOCAPD_SOCKET`, the only socket in /run/mocapd, or port 7060 of this machine.
    #[arg(long, value_name = "unix:PATH|http://HOST:PORT", global = true)]
    connect: Option<String>,
    /// The file with the token, where the service wants one
    #[arg(long, value_name = "FILE", global = true)]
    token_file: Option<PathBuf>,
    /// Print the service's answer as one JSON document
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    order: Order,
}

#[derive(Debug, clap::Subcommand)]
enum Order {
    /// Tell how things stand
    Status {
        /// Again every second, until Ctrl-C
        #[arg(long)]
        watch: bool,
    },
    /// Start the device, and keep what it sends for the pre-roll
    Arm,
    /// Stop the device and forget the pre-roll
    Disarm,
    /// Begin a take; done when its first frame would survive a power cut
    Start {
        /// Name of the take; without it the configuration names it
        #[arg(long)]
        name: Option<String>,
        /// A note that goes into the take as its first event
        #[arg(long)]
        notes: Option<String>,
        /// How much of what came before belongs to the take; without it as configured
        #[arg(long, value_name = "TIME", value_parser = mocapd_service::units::duration)]
        pre_roll: Option<Duration>,
    },
    /// End the take; done when its ledger would survive a power cut. Exit code 3 when frames were lost
    Stop,
    /// Put a mark into the take
    Mark {
        /// What it says
        #[arg(default_value = "")]
        text: String,
    },
    /// Write a take of what the pre-roll holds, and go on
    SaveLast {
        /// How much of it
        #[arg(value_name = "TIME", value_parser = values::length)]
        length: Duration,
        /// Name of the take; without it the configuration names it
        #[arg(long)]
        name: Option<String>,
    },
    /// List the takes in the service's folder, newest first: when each was last written, size, health, name, why it ended
    Takes {
        /// How many at most
        #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..=1000))]
        limit: u16,
    },
    /// List what is attached to the service's machine
    Devices,
    /// Tell what happens, as it happens, until Ctrl-C
    Events,
    /// Fetch a take
    Download {
        /// Its name, as `takes` tells it
        name: String,
        /// The file to write; without it NAME.take in this folder
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
    },
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let target = Target::find(args.connect.as_deref())?;
    let client = Client::new(target, args.token_file.as_deref())?;
    match &args.order {
        Order::Status { watch: true } => watch(&client, args.json),
        Order::Status { watch: false } => status(&client, args.json),
        Order::Arm => state(&client, "/v1/arm", args.json),
        Order::Disarm => state(&client, "/v1/disarm", args.json),
        Order::Start { name, notes, pre_roll } => {
            let (name, notes) = (name.as_deref(), notes.as_deref());
            let pre_roll_s = pre_roll.map(|pre_roll| pre_roll.as_secs_f64());
            start(&client, name, notes, pre_roll_s, args.json)
        }
        Order::Stop => stop(&client, args.json),
        Order::Mark { text } => mark(&client, text, args.json),
        Order::SaveLast { length, name } => {
            save_last(&client, name.as_deref(), length.as_secs_f64(), args.json)
        }
        Order::Takes { limit } => takes(&client, *limit, args.json),
        Order::Devices => devices(&client, args.json),
        Order::Events => events::follow(&client, args.json),
        Order::Download { name, output } => {
            let report = events::download(&client, name, output.as_deref())?;
            if args.json {
                print_json(&report)?;
            }
            Ok(Outcome::Done)
        }
    }
}

/// What a document means; a service of another version may say other things.
fn read<T: DeserializeOwned>(document: &Value) -> anyhow::Result<T> {
    T::deserialize(document).context("the service answered what this version does not know")
}

fn tell<T: DeserializeOwned>(
    document: &Value,
    json: bool,
    words: impl FnOnce(&T) -> String,
) -> anyhow::Result<T> {
    if json {
        print_json(document)?;
        return read(document);
    }
    let answer = read(document)?;
    print(&words(&answer))?;
    Ok(answer)
}

fn status(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    tell(&client.get("/v1/status")?, json, words::status)?;
    Ok(Outcome::Done)
}

fn state(client: &Client, path: &str, json: bool) -> anyhow::Result<Outcome> {
    let document = client.order(path, json!({}))?;
    tell::<Status>(&document, json, |status| format!("{}\n", words::state(status.state)))?;
    Ok(Outcome::Done)
}

fn start(
    client: &Client,
    name: Option<&str>,
    notes: Option<&str>,
    pre_roll_s: Option<f64>,
    json: bool,
) -> anyhow::Result<Outcome> {
    let body = json!({"name": name, "notes": notes, "pre_roll_s": pre_roll_s});
    let started: Started = tell(&client.order("/v1/start", body)?, json, words::started)?;
    for remark in &started.remarks {
        say(remark);
    }
    Ok(Outcome::Done)
}

fn stop(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let document = client.order("/v1/stop", json!({}))?;
    stopped(&document, json)
}

fn save_last(
    client: &Client,
    name: Option<&str>,
    seconds: f64,
    json: bool,
) -> anyhow::Result<Outcome> {
    let document = client.order("/v1/save-last", json!({"name": name, "seconds": seconds}))?;
    stopped(&document, json)
}

fn stopped(document: &Value, json: bool) -> anyhow::Result<Outcome> {
    let stopped: Stopped = tell(document, json, words::stopped)?;
    for remark in &stopped.remarks {
        say(remark);
    }
    let losses = ledger::losses(&stopped.ledger);
    if let Some(losses) = &losses {
        say(&format!("{}: not in the take: {losses}", stopped.name));
    }
    let is_displaced = stopped.file != FileState::InPlace;
    Ok(Outcome::of(losses.is_some() || !is_whole(&stopped.ledger) || is_displaced))
}

fn is_whole(ledger: &LedgerDocument) -> bool {
    ledger.finished && ledger.closes
}

fn mark(client: &Client, text: &str, json: bool) -> anyhow::Result<Outcome> {
    let document = client.order("/v1/mark", json!({"text": text}))?;
    tell::<Marked>(&document, json, |marked| format!("marked at frame {}\n", marked.row))?;
    Ok(Outcome::Done)
}

fn takes(client: &Client, limit: u16, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get(&format!("/v1/takes?limit={limit}"))?;
    tell::<Vec<TakeSummary>>(&document, json, |takes| words::takes(takes))?;
    Ok(Outcome::Done)
}

fn devices(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get("/v1/devices")?;
    tell::<Vec<ListedDevice>>(&document, json, |listed| devices::words(listed))?;
    Ok(Outcome::Done)
}

const EVERY: Duration = Duration::from_secs(1);

/// Between looks whether it was Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// A line every second.
fn watch(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let stop = stop_on_signal()?;
    loop {
        let document = client.get("/v1/status")?;
        if json {
            print_json_text(&document.to_string())?;
        } else {
            let status: Status = read(&document)?;
            print(&format!("{}\n", words::watched(&status)))?;
        }
        for _ in 0..EVERY.as_millis() / LOOK.as_millis() {
            if stop.load(Ordering::Relaxed) {
                return Ok(Outcome::Done);
            }
            std::thread::sleep(LOOK);
        }
    }
}
