//! Misbehaving devices: each ends in a defined state, with a message that says what to do.

use std::{
    sync::atomic::AtomicBool,
    time::{Duration, Instant},
};

use anyhow::ensure;
use mocapd_simulator::gadget::Bulk;
use usb_gadget::{
    Class, Config, Gadget, Id, Strings, Udc,
    function::custom::{Custom, Endpoint, EndpointDirection, Interface, TransferType},
    udcs,
};

use crate::{
    Measurement,
    attached::wait_for_usb,
    ledger::LedgerReport,
    misbehaving::{MisbehavingDevice, garbage, ignores_commands, serve_with_fault, silent},
    recorder::{User, mocapd, record},
};

/// More than the time for five tries of a command, one second each.
const ENDS_WITHIN: Duration = Duration::from_secs(60);

/// Number of stalls in [`stalls`].
const STALLS: u64 = 5;

fn stalling(line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    let mut stalled = 0;
    serve_with_fault(line, stop, Duration::ZERO, |line, writes| {
        // The first writes are the answers to Identify.
        if stalled < STALLS && writes >= 50 * (stalled + 1) {
            stalled += 1;
            line.stall()?;
        }
        Ok(())
    })
}

pub(crate) fn stalls() -> Measurement {
    let device = MisbehavingDevice::start("STALL1", stalling)?;
    let ran = record(&device.uri, "/tmp/stall.take", &["--seconds", "5s"])?;
    let ran = ran.finish(ENDS_WITHIN)?;
    ensure!(matches!(ran.code, Some(0 | 3)), "{ran:?}");
    ran.mentions(&["the device stalled and its endpoint was cleared"])?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes()?;
    ensure!(ledger.ending == "stopped", "{ledger:?}");
    let info = mocapd(User::Dialout, &["info", "/tmp/stall.take"])?.stdout;
    let noted = info.matches("the device stalled").count() as u64;
    ensure!(noted == STALLS, "{noted} of {STALLS} stalls in {info}");
    device.stop()?;
    Ok(format!(
        "{noted} of {STALLS} cleared and noted; {} of {} frames, {} damaged messages",
        ledger.recorded, ledger.frames_sent, ledger.damaged
    ))
}

fn stalling_for_good(line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    serve_with_fault(
        line,
        stop,
        Duration::ZERO,
        |line, writes| {
            if writes >= 100 { line.stall() } else { Ok(()) }
        },
    )
}

pub(crate) fn stalls_for_good() -> Measurement {
    let device = MisbehavingDevice::start("STALL2", stalling_for_good)?;
    let ran = record(&device.uri, "/tmp/stalled.take", &["--seconds", "10s"])?;
    let ran = ran.finish(ENDS_WITHIN)?.with_code(1)?;
    ran.mentions(&["stalls again each time it is cleared", "plug it in again", "ends early"])?;
    let info = mocapd(User::Dialout, &["info", "/tmp/stalled.take"])?;
    ensure!(info.stdout.contains("frames"), "{info:?}");
    Ok("ends with a line; the take up to there can be read".to_owned())
}

/// Checks that `record` refuses a device; returns how long that takes, and its processor time, which reveals a busy
/// loop.
fn refused(uri: &str, facts: &[&str]) -> anyhow::Result<(Duration, f64)> {
    let started = Instant::now();
    let mut recorder = record(uri, "/tmp/refused.take", &[])?;
    let mut processor_s = 0.0;
    while recorder.ended().is_none() && started.elapsed() < ENDS_WITHIN {
        processor_s = recorder.processor_s().unwrap_or(processor_s);
        std::thread::sleep(Duration::from_millis(20));
    }
    let ran = recorder.finish(Duration::ZERO)?;
    let took = started.elapsed();
    ran.with_code(1)?.mentions(facts)?;
    ensure!(!std::path::Path::new("/tmp/refused.take").exists(), "an empty take is left");
    Ok((took, processor_s))
}

pub(crate) fn sends_nothing() -> Measurement {
    let device = MisbehavingDevice::start("MUTE1", silent)?;
    let (took, processor_s) = refused(&device.uri, &["does not answer", "switched on"])?;
    device.stop()?;
    ensure!(processor_s < 0.5 * took.as_secs_f64(), "it spins: {processor_s:.2} s of {took:?}");
    Ok(format!("ends after {:.1} s, {processor_s:.2} s of them busy", took.as_secs_f64()))
}

pub(crate) fn sends_garbage() -> Measurement {
    let device = MisbehavingDevice::start("NOISE1", garbage)?;
    let (took, _) = refused(&device.uri, &["does not understand", "?driver=NAME"])?;
    device.stop()?;
    let device = MisbehavingDevice::start("NOISE2", ignores_commands)?;
    let (deaf_took, _) = refused(&device.uri, &["accept commands", "switch it off and on"])?;
    device.stop()?;
    Ok(format!(
        "ends after {:.1} s; one that accepts no commands either, after {:.1} s",
        took.as_secs_f64(),
        deaf_took.as_secs_f64()
    ))
}

/// A gadget whose endpoints are not a pair of bulk endpoints.
fn liar(serial: &str, endpoints: Vec<Endpoint>) -> anyhow::Result<(usb_gadget::RegGadget, Custom)> {
    let mut interface = Interface::new(Class::vendor_specific(0x4d, 1), "mocapd link");
    for endpoint in endpoints {
        interface = interface.with_endpoint(endpoint);
    }
    let (custom, handle) = Custom::builder().with_interface(interface).build();
    let strings = Strings::new("mocapd", "mocapd-sim", serial);
    let gadget = Gadget::new(Class::INTERFACE_SPECIFIC, Id::new(0x1209, 1), strings)
        .with_config(Config::new("lies").with_function(handle));
    let mut all: Vec<Udc> = udcs()?;
    all.sort_by_key(|udc| udc.name().to_owned());
    let udc = all.first().ok_or_else(|| anyhow::anyhow!("no controller"))?;
    let made = gadget.bind(udc)?;
    wait_for_usb(serial)?;
    Ok((made, custom))
}

pub(crate) fn lies() -> Measurement {
    let to_host = || EndpointDirection::device_to_host();
    let from_host = || EndpointDirection::host_to_device();
    let (_keep, direction) = to_host();
    let one_way = liar("LIAR1", vec![Endpoint::bulk(direction)])?;
    let (took_1, _) =
        refused("usb:1209:0001:LIAR1", &["bulk endpoint in each direction", "found bulk 8"])?;
    drop(one_way);
    let ((_k1, to), (_k2, from)) = (to_host(), from_host());
    let interrupts = vec![
        Endpoint::custom(to, TransferType::Interrupt),
        Endpoint::custom(from, TransferType::Interrupt),
    ];
    let interrupts = liar("LIAR2", interrupts)?;
    let (took_2, _) =
        refused("usb:1209:0001:LIAR2", &["bulk endpoint in each direction", "found other"])?;
    drop(interrupts);
    let ((_k3, to), (_k4, from)) = (to_host(), from_host());
    let mut small = Endpoint::bulk(to);
    small.max_packet_size_hs = 24;
    let packets = liar("LIAR3", vec![small, Endpoint::bulk(from)])?;
    // The controller refuses such a configuration: the device stays unconfigured.
    let (took_3, _) = refused("usb:1209:0001:LIAR3", &["is not a device that mocapd can read"])?;
    drop(packets);
    let longest = took_1.max(took_2).max(took_3);
    Ok(format!("three lies refused, each within {:.1} s", longest.as_secs_f64()))
}

/// Sends half a message, then pulls the cable.
fn vanishing(line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    serve_with_fault(line, stop, Duration::ZERO, |line, writes| {
        if writes < 100 {
            return Ok(());
        }
        mocapd_simulator::line::Line::write(line, &[1, 2, 3, 4, 5])?;
        Err(std::io::ErrorKind::BrokenPipe.into())
    })
}

pub(crate) fn vanishes() -> Measurement {
    let device = MisbehavingDevice::start("GONE1", vanishing)?;
    let uri = device.uri.clone();
    let ran = record(&uri, "/tmp/gone.take", &["--reconnect", "1s"])?;
    let ran = ran.finish(ENDS_WITHIN)?.with_code(3)?;
    ran.mentions(&["is gone: plug it in again within 1 s", "the device was disconnected"])?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes()?;
    ensure!(ledger.ending == "disconnected" && ledger.recorded > 0, "{ledger:?}");
    Ok(format!("{} frames of before are in the take, which closes", ledger.recorded))
}

pub(crate) fn answers_late() -> Measurement {
    let late = |late_ms| {
        move |line: Bulk, stop: &AtomicBool| {
            serve_with_fault(line, stop, Duration::from_millis(late_ms), |_, _| Ok(()))
        }
    };
    let device = MisbehavingDevice::start("LATE1", late(1500))?;
    let ran = record(&device.uri, "/tmp/late.take", &["--seconds", "2s"])?;
    let ran = ran.finish(ENDS_WITHIN)?.with_code(0)?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes()?;
    device.stop()?;
    let device = MisbehavingDevice::start("LATE2", late(20_000))?;
    let (took, _) = refused(&device.uri, &["does not answer"])?;
    device.stop()?;
    Ok(format!(
        "1.5 s late: recorded, {} frames; 20 s late: ends after {:.1} s",
        ledger.recorded,
        took.as_secs_f64()
    ))
}
