//! Throughput of the transport, and the load that the whole pipeline sustains.

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
    Measurement,
    ledger::LedgerReport,
    misbehaving::{MisbehavingDevice, send_forever},
    recorder::record,
    simulator::Simulator,
};

/// Minimum throughput of the transport, as a fraction of a bare loop's, on an idle machine and on a loaded one.
const PART_MIN: f64 = 0.9;
const PART_MIN_BESIDE_OTHERS: f64 = 0.6;

/// The two are measured alternately, many times and briefly, so that other load affects both. If the median is too low,
/// more turns are measured.
const TURNS: usize = 12;
const TURNS_MAX: usize = 48;
const TURN: Duration = Duration::from_millis(500);

fn pouring(mut line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    send_forever(&mut line, &[0x55; 64 << 10], stop)
}

/// Throughput of a bare loop, bytes per second: transfers are queued ahead and their bytes discarded.
fn bare_loop(serial: &str, length: Duration) -> anyhow::Result<f64> {
    let info = nusb::list_devices().wait()?.find(|info| info.serial_number() == Some(serial));
    let interface = info.context("the device")?.open().wait()?.claim_interface(0).wait()?;
    let address = interface
        .descriptor()
        .and_then(|descriptor| descriptor.endpoints().map(|e| e.address()).find(|a| a & 0x80 != 0));
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

fn our_transport(serial: &str, length: Duration) -> anyhow::Result<f64> {
    let mut transport = UsbTransport::open(0x1209, 1, Some(serial))?;
    let mut buffer = vec![0; 64 << 10];
    let (started, mut bytes) = (Instant::now(), 0);
    while started.elapsed() < length {
        bytes += transport.read(&mut buffer)?;
    }
    Ok(bytes as f64 / started.elapsed().as_secs_f64())
}

pub(crate) fn transport() -> Measurement {
    compared_with_a_bare_loop(PART_MIN_BESIDE_OTHERS)
}

/// Needs the whole machine.
pub(crate) fn transport_alone() -> Measurement {
    compared_with_a_bare_loop(PART_MIN)
}

fn compared_with_a_bare_loop(part_min: f64) -> Measurement {
    let device = MisbehavingDevice::start("SPEED1", pouring)?;
    let (mut theirs, mut mine, mut parts) = (0.0, 0.0, Vec::new());
    while parts.len() < TURNS || (parts.len() < TURNS_MAX && median(&mut parts) < part_min) {
        for turn in 0..TURNS {
            // Alternate the order.
            let early = if turn % 2 == 0 { Some(bare_loop("SPEED1", TURN)?) } else { None };
            let our_part = our_transport("SPEED1", TURN)?;
            let bare_part = early.map_or_else(|| bare_loop("SPEED1", TURN), Ok)?;
            parts.push(our_part / bare_part);
            mine += our_part;
            theirs += bare_part;
        }
    }
    device.stop()?;
    let (turns, part) = (parts.len() as f64, median(&mut parts));
    let summary = format!(
        "{:.1} MB/s and a bare loop {:.1} MB/s; median of {turns} turns: {:.0} %",
        mine / turns / 1e6,
        theirs / turns / 1e6,
        part * 100.0
    );
    ensure!(part >= part_min, "{summary}");
    Ok(summary)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Markers and frames per second that an otherwise idle machine must record without a lost frame.
const LEAST: (u32, u32) = (64, 240);

/// Loads of which one must be recorded without a lost frame beside other load: how much of a processor the emulated
/// machine gets is not known. A recorder that lost frames by a fault of its own would lose them at each.
const BESIDE_OTHERS: [(u32, u32); 3] = [LEAST, (64, 120), (64, 60)];

/// Several times the capacity of the rings (2 s) and of the device's queue (1 s).
const STEADY: Duration = Duration::from_secs(20);
const WHOLE: Duration = Duration::from_secs(60);

/// Heavier loads, in order.
const HEAVIER: [(u32, u32); 7] =
    [(64, 360), (64, 480), (64, 720), (64, 1000), (128, 1000), (256, 1000), (512, 1000)];

/// Long enough that rings (2 s) and the device's queue (1 s) cannot hide an overload.
const TRIAL: Duration = Duration::from_secs(10);

/// Result of recording a load.
struct Sustained {
    is_whole: bool,
    summary: String,
}

/// Records a load for this long.
fn at_load((markers, rate): (u32, u32), length: Duration) -> anyhow::Result<Sustained> {
    let (markers_asked, rate_asked) = (markers.to_string(), rate.to_string());
    let options = ["--markers", &markers_asked, "--rate", &rate_asked, "--loop"];
    let simulator = Simulator::bulk("LOAD1", &options)?;
    let seconds = format!("{}s", length.as_secs());
    let recorder = record(&simulator.uri, "/tmp/load.take", &["--seconds", &seconds])?;
    let ran = recorder.finish(length * 5)?;
    ensure!(matches!(ran.code, Some(0 | 3)), "{ran:?}");
    let report = ran.json()?;
    let ledger = LedgerReport::of(&report)?;
    ledger.closes()?;
    let processor_s = report["process"]["cpu_s"].as_f64().unwrap_or(f64::NAN);
    let lost = ledger.lost + ledger.unknown + simulator.stop()?.dropped;
    Ok(Sustained {
        is_whole: lost == 0 && ledger.recorded >= u64::from(rate) * length.as_secs(),
        summary: format!(
            "{markers} markers at {rate} Hz for {} s: {} frames, {lost} lost, {processor_s:.1} s of processor time",
            length.as_secs(),
            ledger.recorded
        ),
    })
}

pub(crate) fn pipeline() -> Measurement {
    let mut tried = Vec::new();
    for load in BESIDE_OTHERS {
        let Sustained { is_whole, summary } = at_load(load, STEADY)?;
        tried.push(summary);
        if is_whole {
            return Ok(tried.join("; "));
        }
    }
    bail!("{}", tried.join("; "))
}

/// The heaviest load that passes a short trial and then the whole duration. It measures the machine, and takes minutes.
pub(crate) fn heaviest_load() -> Measurement {
    let mut sustained = vec![LEAST];
    for load in HEAVIER {
        if !at_load(load, TRIAL)?.is_whole {
            break;
        }
        sustained.push(load);
    }
    while let Some(load) = sustained.pop() {
        let Sustained { is_whole, summary } = at_load(load, WHOLE)?;
        if is_whole {
            return Ok(summary);
        }
        println!("   not sustained: {summary}");
    }
    bail!("even the lightest load of {LEAST:?} loses frames")
}
