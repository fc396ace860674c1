//! What the transport costs, and what the whole pipeline keeps up with here.

use std::{
    sync::atomic::AtomicBool,
    time::{Duration, Instant},
};

use anyhow::{Context, bail, ensure};
use mocapd_drivers::transport::{
    Transport,
    usb::{TRANSFER_BYTES, TRANSFERS, UsbTransport},
};
use mocapd_simulator::gadget::Bulk;
use nusb::{
    MaybeFuture,
    transfer::{self, In},
};

use crate::{
    Measured,
    ledger::Account,
    odd::{Odd, pour},
    recorder::record,
    simulator::Simulator,
};

/// Of a bare loop's bytes.
const PART_MIN: f64 = 0.9;

/// The two are measured in turn, often and for a short time: what else the machine does meanwhile meets both. Where
/// that is much, more turns are taken before the median counts.
const TURNS: usize = 12;
const TURNS_MAX: usize = 48;
const TURN: Duration = Duration::from_millis(500);

fn pouring(mut line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    pour(&mut line, &[0x55; 64 << 10], stop)
}

/// What any program would write: transfers queued ahead, and their bytes thrown away.
fn bare(serial: &str, length: Duration) -> anyhow::Result<f64> {
    let info = nusb::list_devices().wait()?.find(|info| info.serial_number() == Some(serial));
    let interface = info.context("the device")?.open().wait()?.claim_interface(0).wait()?;
    let address = interface
        .descriptor()
        .and_then(|said| said.endpoints().map(|e| e.address()).find(|a| a & 0x80 != 0));
    let mut endpoint = interface.endpoint::<transfer::Bulk, In>(address.context("no endpoint")?)?;
    for _ in 0..TRANSFERS {
        let buffer = endpoint.allocate(TRANSFER_BYTES);
        endpoint.submit(buffer);
    }
    let (started, mut bytes) = (Instant::now(), 0);
    while started.elapsed() < length {
        let done = endpoint.wait_next_complete(Duration::from_secs(5)).context("no bytes")?;
        done.status?;
        bytes += done.actual_len;
        endpoint.submit(done.buffer);
    }
    let per_s = bytes as f64 / started.elapsed().as_secs_f64();
    endpoint.cancel_all();
    while endpoint.pending() > 0 {
        endpoint.wait_next_complete(Duration::from_secs(5)).context("a transfer stays away")?;
    }
    Ok(per_s)
}

fn ours(serial: &str, length: Duration) -> anyhow::Result<f64> {
    let mut transport = UsbTransport::open(0x1209, 1, Some(serial))?;
    let mut buffer = vec![0; 64 << 10];
    let (started, mut bytes) = (Instant::now(), 0);
    while started.elapsed() < length {
        bytes += transport.read(&mut buffer)?;
    }
    Ok(bytes as f64 / started.elapsed().as_secs_f64())
}

pub(crate) fn transport() -> Measured {
    let device = Odd::start("SPEED1", pouring)?;
    let (mut theirs, mut mine, mut parts) = (0.0, 0.0, Vec::new());
    while parts.len() < TURNS || (parts.len() < TURNS_MAX && median(&mut parts) < PART_MIN) {
        for turn in 0..TURNS {
            // Now the one first, now the other.
            let early = if turn % 2 == 0 { Some(bare("SPEED1", TURN)?) } else { None };
            let our_part = ours("SPEED1", TURN)?;
            let bare_part = early.map_or_else(|| bare("SPEED1", TURN), Ok)?;
            parts.push(our_part / bare_part);
            mine += our_part;
            theirs += bare_part;
        }
    }
    device.stop()?;
    let (turns, part) = (parts.len() as f64, median(&mut parts));
    let words = format!(
        "{:.1} MB/s and a bare loop {:.1} MB/s; median of {turns} turns: {:.0} %",
        mine / turns / 1e6,
        theirs / turns / 1e6,
        part * 100.0
    );
    ensure!(part >= PART_MIN, "{words}");
    Ok(words)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Markers and frames a second, from light to heavy; the first is the least that must go.
const LOADS: [(u32, u32); 8] =
    [(64, 240), (64, 360), (64, 480), (64, 720), (64, 1000), (128, 1000), (256, 1000), (512, 1000)];

/// Longer than rings (2 s) and the device's queue (1 s) hide what is too much.
const TRIAL: Duration = Duration::from_secs(10);
const WHOLE: Duration = Duration::from_secs(60);

/// Lighter loads that are tried for the whole time before the first one is: a minute each, and the emulator is stopped
/// after ten.
const FALLBACKS: usize = 2;

/// Records a load so long: the account, and the processor time of the recorder.
fn at_load((markers, rate): (u32, u32), length: Duration) -> anyhow::Result<(Account, f64, u64)> {
    let (markers, rate) = (markers.to_string(), rate.to_string());
    let simulator = Simulator::bulk("LOAD1", &["--markers", &markers, "--rate", &rate, "--loop"])?;
    let seconds = format!("{}s", length.as_secs());
    let recorder = record(&simulator.uri, "/tmp/load.take", &["--seconds", &seconds])?;
    let ran = recorder.finish(length * 5)?;
    ensure!(matches!(ran.code, Some(0 | 3)), "{ran:?}");
    let report = ran.json()?;
    let account = Account::of(&report)?;
    account.closes()?;
    let processor_s = report["process"]["cpu_s"].as_f64().unwrap_or(f64::NAN);
    let sent = simulator.stop()?;
    Ok((account, processor_s, sent.dropped))
}

pub(crate) fn pipeline() -> Measured {
    let mut sustained = 0;
    for (index, &load) in LOADS.iter().enumerate() {
        let (account, _, dropped) = at_load(load, TRIAL)?;
        let asked = u64::from(load.1) * TRIAL.as_secs();
        if account.lost + account.unknown + dropped > 0 || account.recorded < asked * 99 / 100 {
            break;
        }
        sustained = index;
    }
    // The first one anyway: that is the bar.
    let lightest = sustained.saturating_sub(FALLBACKS);
    let first = (lightest > 0).then_some(&LOADS[0]);
    for &load in LOADS[lightest..=sustained].iter().rev().chain(first) {
        let (account, processor_s, dropped) = at_load(load, WHOLE)?;
        let (markers, rate) = load;
        let lost = account.lost + account.unknown + dropped;
        let words = format!(
            "{markers} markers at {rate} Hz for {} s: {} frames, {lost} lost, {processor_s:.1} s of processor time",
            WHOLE.as_secs(),
            account.recorded
        );
        let asked = u64::from(rate) * WHOLE.as_secs();
        if lost == 0 && account.recorded >= asked {
            return Ok(words);
        }
        println!("   not sustained: {words}");
    }
    bail!("even the lightest load of {:?} loses frames", LOADS[0])
}
