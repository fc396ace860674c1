//! `ctl`: asks a running service, and tells what it answers.

mod client;
mod download;
mod events;
mod orders;
mod target;
mod watch;
mod words;

use std::{path::PathBuf, time::Duration};

use mocapd::outcome::Outcome;

use self::{client::Client, target::Target};
use super::{output::print_json, values};

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
        Order::Status { watch: true } => watch::run(&client, args.json),
        Order::Status { watch: false } => orders::status(&client, args.json),
        Order::Arm => orders::state(&client, "/v1/arm", args.json),
        Order::Disarm => orders::state(&client, "/v1/disarm", args.json),
        Order::Start { name, notes, pre_roll } => {
            let (name, notes) = (name.as_deref(), notes.as_deref());
            let pre_roll_s = pre_roll.map(|pre_roll| pre_roll.as_secs_f64());
            orders::start(&client, name, notes, pre_roll_s, args.json)
        }
        Order::Stop => orders::stop(&client, args.json),
        Order::Mark { text } => orders::mark(&client, text, args.json),
        Order::SaveLast { length, name } => {
            orders::save_last(&client, name.as_deref(), length.as_secs_f64(), args.json)
        }
        Order::Takes { limit } => orders::takes(&client, *limit, args.json),
        Order::Devices => orders::devices(&client, args.json),
        Order::Events => events::follow(&client, args.json),
        Order::Download { name, output } => {
            let report = download::run(&client, name, output.as_deref())?;
            if args.json {
                print_json(&report)?;
            }
            Ok(Outcome::Done)
        }
    }
}
