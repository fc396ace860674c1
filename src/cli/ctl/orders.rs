//! One question or order each, and what is said of the answer.

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{files::FileState, listing::ListedDevice};
use mocapd_service::{
    control::{Marked, Started, Stopped},
    status::{LedgerStatus, Status, TakeSummary},
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::{client::Client, words};
use crate::cli::{
    devices,
    output::{print, print_json, say},
};

/// What a document means; a service of another version may say other things.
pub(super) fn read<T: DeserializeOwned>(document: &Value) -> anyhow::Result<T> {
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

pub(super) fn status(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    tell(&client.get("/v1/status")?, json, words::status)?;
    Ok(Outcome::Done)
}

pub(super) fn state(client: &Client, path: &str, json: bool) -> anyhow::Result<Outcome> {
    let document = client.order(path, json!({}))?;
    tell::<Status>(&document, json, |status| format!("{}\n", words::state(status.state)))?;
    Ok(Outcome::Done)
}

pub(super) fn start(
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

pub(super) fn stop(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let document = client.order("/v1/stop", json!({}))?;
    stopped(&document, json)
}

pub(super) fn save_last(
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
    let losses = words::losses(&stopped.ledger);
    if let Some(losses) = &losses {
        say(&format!("{}: not in the take: {losses}", stopped.name));
    }
    let is_displaced = stopped.file != FileState::InPlace;
    Ok(Outcome::of(losses.is_some() || !is_whole(&stopped.ledger) || is_displaced))
}

fn is_whole(ledger: &LedgerStatus) -> bool {
    ledger.finished && ledger.closes
}

pub(super) fn mark(client: &Client, text: &str, json: bool) -> anyhow::Result<Outcome> {
    let document = client.order("/v1/mark", json!({"text": text}))?;
    tell::<Marked>(&document, json, |marked| format!("marked at frame {}\n", marked.row))?;
    Ok(Outcome::Done)
}

pub(super) fn takes(client: &Client, limit: u16, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get(&format!("/v1/takes?limit={limit}"))?;
    tell::<Vec<TakeSummary>>(&document, json, |takes| words::takes(takes))?;
    Ok(Outcome::Done)
}

pub(super) fn devices(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let document = client.get("/v1/devices")?;
    tell::<Vec<ListedDevice>>(&document, json, |listed| devices::words(listed))?;
    Ok(Outcome::Done)
}
