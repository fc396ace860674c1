//! `ctl rate`, `rename`, `trash`, `trashed` and `restore`.

use mocapd::outcome::{Outcome, UsageError};
use mocapd_service::finished::{MovedTake, TakeNotes, TrashedTake};
use serde_json::{Value, json};

use super::{client::Client, events::encoded, show, text};
use crate::cli::output::{notify, plain};

#[derive(Debug, clap::Args)]
pub(super) struct RateArgs {
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

pub(super) fn rate(client: &Client, args: &RateArgs, json: bool) -> anyhow::Result<Outcome> {
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

pub(super) fn rename(
    client: &Client,
    (name, to): (&str, &str),
    json: bool,
) -> anyhow::Result<Outcome> {
    let path = format!("/v1/takes/{}/rename", encoded(name));
    moved(&client.post(&path, json!({"to": to}))?, json)
}

pub(super) fn trash(client: &Client, name: &str, json: bool) -> anyhow::Result<Outcome> {
    let path = format!("/v1/takes/{}/trash", encoded(name));
    let document = client.post(&path, json!({}))?;
    show::<TrashedTake>(&document, json, |take| {
        let (name, until) = (plain(&take.name), text::time(take.removed_unix_ms));
        format!("{name} is in the trash until {until}\n")
    })?;
    Ok(Outcome::Done)
}

pub(super) fn trashed(client: &Client, limit: u16, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get(&format!("/v1/trash?limit={limit}"))?;
    show::<Vec<TrashedTake>>(&document, json, |takes| text::trashed(takes))?;
    Ok(Outcome::Done)
}

pub(super) fn restore(
    client: &Client,
    name: &str,
    to: Option<&str>,
    json: bool,
) -> anyhow::Result<Outcome> {
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
