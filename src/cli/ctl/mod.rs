//! `ctl`: controls a running service over its HTTP API and prints the answers.

mod client;
mod events;
mod text;

use std::{path::PathBuf, sync::atomic::Ordering, time::Duration};

use anyhow::Context;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{files::FileState, rig::ListedDevice};
use mocapd_service::{
    control::{Marked, Start, Started, Stopped},
    finished::{MovedTake, TakeNotes, TrashedTake},
    status::{PendingStart, Status, TakeSummary},
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use self::{
    client::{Client, Target},
    events::encoded,
};
use crate::cli::{
    devices, ledger,
    output::{notify, plain, print, print_json, print_json_text},
    stop::stop_on_signal,
    values,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Address of the service
    ///
    /// Default: `$MOCAPD_SOCKET`, else the only socket in /run/mocapd, else port 7060 of this machine.
    #[arg(long, value_name = "unix:PATH|http://HOST:PORT", global = true)]
    connect: Option<String>,
    /// File with the access token, if the service requires one
    #[arg(long, value_name = "FILE", global = true)]
    token_file: Option<PathBuf>,
    /// Print the service's answer as one JSON document
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: CtlCommand,
}

#[derive(Debug, clap::Subcommand)]
enum CtlCommand {
    /// Show the status of the service, the device, the take and the disk
    Status {
        /// Repeat every second, until Ctrl-C
        #[arg(long)]
        watch: bool,
    },
    /// Start the device and buffer its frames for the pre-roll
    Arm,
    /// Stop the device and discard the pre-roll
    Disarm,
    /// Start a take; returns when its first frame is safe on disk, or with --at when the start waits
    Start(StartArgs),
    /// Stop the take; returns when its ledger is safe on disk. Exit code 3 if frames were lost
    ///
    /// Without a take, cancels a start that waits for its time.
    Stop,
    /// Cancel the start that waits for its time
    Cancel,
    /// Add a mark to the take
    Mark {
        /// Text of the mark
        #[arg(default_value = "")]
        text: String,
    },
    /// Save the pre-roll, or its end, as a take; the service stays armed or continues recording
    SaveLast {
        /// Length to save, counted back from now [default: all that is held]
        #[arg(value_name = "TIME", value_parser = values::length)]
        length: Option<Duration>,
        /// Name of the take [default: as configured]
        #[arg(long)]
        name: Option<String>,
    },
    /// List the takes in the service's folder, newest first: time of last change, size, health, name, why it ended
    Takes {
        /// Maximum number of takes to list
        #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..=1000))]
        limit: u16,
    },
    /// List the devices attached to the service's machine
    Devices,
    /// Print events as they happen, until Ctrl-C
    Events,
    /// Rate a finished take, or change its notes
    Rate(RateArgs),
    /// Rename a finished take and its notes
    Rename {
        /// Name of the take, as listed by `takes`
        name: String,
        /// The new name
        to: String,
    },
    /// Move a finished take and its notes to the trash
    Trash {
        /// Name of the take, as listed by `takes`
        name: String,
    },
    /// List the takes in the trash, newest first: when they will be removed, size, id
    Trashed {
        /// Maximum number of takes to list
        #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..=1000))]
        limit: u16,
    },
    /// Move a take and its notes back from the trash
    Restore {
        /// Name of the take, for the newest of that name, or its id as listed by `trashed`
        name: String,
        /// Another name for it
        #[arg(long, value_name = "NAME")]
        to: Option<String>,
    },
    /// Download a take, and its notes as NAME.notes.json
    Download {
        /// Name of the take, as listed by `takes`
        name: String,
        /// The file to write [default: NAME.take in the current folder]
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
    },
}

#[derive(Debug, clap::Args)]
struct StartArgs {
    /// Name of the take [default: after subject, session and trial, or as configured]
    #[arg(long)]
    name: Option<String>,
    /// A note to store in the take, as its first event
    #[arg(long)]
    notes: Option<String>,
    /// Length of the pre-roll to include [default: as configured]
    #[arg(long, value_name = "TIME", value_parser = mocapd_service::units::duration)]
    pre_roll: Option<Duration>,
    /// Length after which the take ends by itself, such as 10, 10s or 2min; the pre-roll comes in addition
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    seconds: Option<Duration>,
    /// Start at this time of day, by the clock of the service's machine; the rig has to be armed then
    #[arg(long, value_name = "HH:MM[:SS]")]
    at: Option<String>,
    /// Subject, such as S01: a take without a name is called after subject, session and trial, with a count
    #[arg(long)]
    subject: Option<String>,
    /// Session, such as session1
    #[arg(long)]
    session: Option<String>,
    /// Trial, such as jump
    #[arg(long)]
    trial: Option<String>,
}

impl StartArgs {
    fn request(&self) -> Start {
        Start {
            request_id: None,
            name: self.name.clone(),
            notes: self.notes.clone(),
            pre_roll_s: self.pre_roll.map(|pre_roll| pre_roll.as_secs_f64()),
            seconds: self.seconds.map(|length| length.as_secs_f64()),
            at: self.at.clone(),
            subject: self.subject.clone(),
            session: self.session.clone(),
            trial: self.trial.clone(),
        }
    }
}

/// A length above 0: a number of seconds, or a number with another unit.
fn seconds(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(_) => values::length(&format!("{text}s")),
        Err(_) => values::length(text),
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let target = Target::find(args.connect.as_deref())?;
    let client = Client::new(target, args.token_file.as_deref())?;
    match &args.command {
        CtlCommand::Status { watch: true } => watch(&client, args.json),
        CtlCommand::Status { watch: false } => status(&client, args.json),
        CtlCommand::Arm => state(&client, "/v1/arm", args.json),
        CtlCommand::Disarm => state(&client, "/v1/disarm", args.json),
        CtlCommand::Start(start_args) => start(&client, start_args, args.json),
        CtlCommand::Stop => stop(&client, args.json),
        CtlCommand::Cancel => cancel(&client, args.json),
        CtlCommand::Mark { text } => mark(&client, text, args.json),
        CtlCommand::SaveLast { length, name } => {
            let seconds = length.map(|length| length.as_secs_f64());
            let body = json!({"name": name, "seconds": seconds});
            stopped(&client.post("/v1/save-last", body)?, args.json)
        }
        CtlCommand::Takes { limit } => takes(&client, *limit, args.json),
        CtlCommand::Devices => devices(&client, args.json),
        CtlCommand::Events => events::follow(&client, args.json),
        CtlCommand::Rate(rate) => self::rate(&client, rate, args.json),
        CtlCommand::Rename { name, to } => rename(&client, (name, to), args.json),
        CtlCommand::Trash { name } => trash(&client, name, args.json),
        CtlCommand::Trashed { limit } => trashed(&client, *limit, args.json),
        CtlCommand::Restore { name, to } => restore(&client, name, to.as_deref(), args.json),
        CtlCommand::Download { name, output } => {
            let report = events::download(&client, name, output.as_deref())?;
            if args.json {
                print_json(&report)?;
            }
            Ok(Outcome::Done)
        }
    }
}

/// Deserialises an answer; a service of another version may answer something else.
fn read<T: DeserializeOwned>(document: &Value) -> anyhow::Result<T> {
    T::deserialize(document).context("cannot read the reply: the service may be of another version")
}

/// Prints an answer, as JSON or as text, and returns it.
fn show<T: DeserializeOwned>(
    document: &Value,
    json: bool,
    text: impl FnOnce(&T) -> String,
) -> anyhow::Result<T> {
    if json {
        print_json(document)?;
        return read(document);
    }
    let answer = read(document)?;
    print(&text(&answer))?;
    Ok(answer)
}

fn status(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    show(&client.get("/v1/status")?, json, text::status)?;
    Ok(Outcome::Done)
}

fn state(client: &Client, path: &str, json: bool) -> anyhow::Result<Outcome> {
    let document = client.post(path, json!({}))?;
    show::<Status>(&document, json, |status| format!("{}\n", text::state(status.state)))?;
    Ok(Outcome::Done)
}

fn start(client: &Client, args: &StartArgs, json: bool) -> anyhow::Result<Outcome> {
    let document = client.post("/v1/start", serde_json::to_value(args.request())?)?;
    let remarks = if args.at.is_some() {
        let text =
            |pending: &PendingStart| format!("a take will be started at {}\n", plain(&pending.at));
        show::<PendingStart>(&document, json, text)?.remarks
    } else {
        show::<Started>(&document, json, text::started)?.remarks
    };
    remarks.iter().for_each(|remark| notify(remark));
    Ok(Outcome::Done)
}

fn stop(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let status: Status = read(&client.get("/v1/status")?)?;
    match (&status.take, &status.pending_start) {
        (None, Some(_)) => return cancel(client, json),
        (Some(_), Some(pending)) => {
            notify(&format!(
                "a start still waits for {}: `mocapd ctl cancel` cancels it",
                pending.at
            ));
        }
        (_, None) => {}
    }
    stopped(&client.post("/v1/stop", json!({}))?, json)
}

fn cancel(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let document = client.post("/v1/cancel", json!({}))?;
    let text =
        |pending: &PendingStart| format!("the start at {} is cancelled\n", plain(&pending.at));
    show::<PendingStart>(&document, json, text)?;
    Ok(Outcome::Done)
}

/// Prints the result of a command that ended a take.
fn stopped(document: &Value, json: bool) -> anyhow::Result<Outcome> {
    let stopped: Stopped = show(document, json, text::stopped)?;
    stopped.remarks.iter().for_each(|remark| notify(remark));
    let losses = ledger::losses(&stopped.ledger);
    if let Some(losses) = &losses {
        notify(&format!("{}: not in the take: {losses}", stopped.name));
    }
    let is_balanced = stopped.ledger.finished && stopped.ledger.closes;
    let is_displaced = stopped.file != FileState::InPlace;
    Ok(Outcome::of(losses.is_some() || !is_balanced || is_displaced))
}

fn mark(client: &Client, text: &str, json: bool) -> anyhow::Result<Outcome> {
    let document = client.post("/v1/mark", json!({"text": text}))?;
    show::<Marked>(&document, json, |marked| format!("marked at frame {}\n", marked.row))?;
    Ok(Outcome::Done)
}

fn takes(client: &Client, limit: u16, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get(&format!("/v1/takes?limit={limit}"))?;
    show::<Vec<TakeSummary>>(&document, json, |takes| text::takes(takes))?;
    Ok(Outcome::Done)
}

fn devices(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get("/v1/devices")?;
    show::<Vec<ListedDevice>>(&document, json, |listed| devices::text(listed))?;
    Ok(Outcome::Done)
}

const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// Interval of the checks for Ctrl-C.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Prints one status line every second.
fn watch(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let stop = stop_on_signal()?;
    loop {
        let document = client.get("/v1/status")?;
        if json {
            print_json_text(&document.to_string())?;
        } else {
            let status: Status = read(&document)?;
            print(&format!("{}\n", text::watch_line(&status)))?;
        }
        for _ in 0..STATUS_INTERVAL.as_millis() / POLL_INTERVAL.as_millis() {
            if stop.load(Ordering::Relaxed) {
                return Ok(Outcome::Done);
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }
}

#[derive(Debug, clap::Args)]
struct RateArgs {
    /// Name of the take, as listed by `takes`
    name: String,
    /// The rating [default: unchanged]
    rating: Option<Rating>,
    /// New notes, in place of those that the take has; "" for none [default: unchanged]
    #[arg(long)]
    notes: Option<String>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Rating {
    /// To be used
    Good,
    /// Not to be used
    Bad,
    /// Not rated
    None,
}

impl Rating {
    fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Bad => "bad",
            Self::None => "none",
        }
    }
}

fn rate(client: &Client, args: &RateArgs, json: bool) -> anyhow::Result<Outcome> {
    if args.rating.is_none() && args.notes.is_none() {
        let message = "nothing to change: give a rating (good, bad or none), --notes TEXT, or both";
        return Err(UsageError(message.to_owned()).into());
    }
    let path = format!("/v1/takes/{}/notes", encoded(&args.name));
    let body = json!({"rating": args.rating.map(Rating::name), "text": args.notes});
    let document = client.post(&path, body)?;
    show::<TakeNotes>(&document, json, |notes| text::notes(&args.name, notes))?;
    Ok(Outcome::Done)
}

fn rename(client: &Client, (name, to): (&str, &str), json: bool) -> anyhow::Result<Outcome> {
    let path = format!("/v1/takes/{}/rename", encoded(name));
    moved(&client.post(&path, json!({"to": to}))?, json)
}

fn trash(client: &Client, name: &str, json: bool) -> anyhow::Result<Outcome> {
    let path = format!("/v1/takes/{}/trash", encoded(name));
    let document = client.post(&path, json!({}))?;
    show::<TrashedTake>(&document, json, |take| {
        let (name, until) = (plain(&take.name), text::time(take.removed_unix_ms));
        format!("{name} is in the trash until {until}\n")
    })?;
    Ok(Outcome::Done)
}

fn trashed(client: &Client, limit: u16, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get(&format!("/v1/trash?limit={limit}"))?;
    show::<Vec<TrashedTake>>(&document, json, |takes| text::trashed(takes))?;
    Ok(Outcome::Done)
}

fn restore(client: &Client, name: &str, to: Option<&str>, json: bool) -> anyhow::Result<Outcome> {
    let path = format!("/v1/trash/{}/restore", encoded(name));
    moved(&client.post(&path, json!({"to": to}))?, json)
}

fn moved(document: &Value, json: bool) -> anyhow::Result<Outcome> {
    let moved: MovedTake = show(document, json, |take: &MovedTake| {
        format!("{}\n", plain(&take.path.display().to_string()))
    })?;
    moved.remarks.iter().for_each(|remark| notify(remark));
    Ok(Outcome::Done)
}
