//! Permissions and other obstacles to opening a device.

use std::{fs, time::Duration};

use anyhow::{Context, ensure};
use nusb::{
    MaybeFuture,
    transfer::{Buffer, Bulk, In},
};

use crate::{
    Measurement,
    attached::{TIMEOUT, run, set_rules, wait_for_absence, wait_for_port},
    ledger::LedgerReport,
    misbehaving::{MisbehavingDevice, silent},
    recorder::{Mocapd, User, mocapd, record},
    simulator::Simulator,
};

fn listing(user: User) -> anyhow::Result<String> {
    Ok(mocapd(user, &["devices"])?.with_code(0)?.stdout)
}

/// The line of a device in the listing, and the problem line after it, if any.
fn lines_of<'a>(listing: &'a str, device: &str) -> anyhow::Result<(&'a str, Option<&'a str>)> {
    let mut lines = listing.lines().skip_while(|line| !line.starts_with(device));
    let line = lines.next().with_context(|| format!("{device} is not in: {listing}"))?;
    Ok((line, lines.next().filter(|line| line.starts_with(' '))))
}

pub(crate) fn listed_with_our_rules() -> Measurement {
    let _bulk = Simulator::bulk("LIST1", &[])?;
    let _port = Simulator::port("LIST2", &[])?;
    let seen = listing(User::Dialout)?;
    for device in ["usb:1209:0001:LIST1", "serial:/dev/ttyACM0"] {
        let (line, problem) = lines_of(&seen, device)?;
        ensure!(line.contains("dvmc") && line.contains("mocapd-sim"), "{line}");
        ensure!(problem.is_none(), "{device}: {problem:?}");
    }
    let refused = listing(User::Nobody)?;
    for device in ["usb:1209:0001:LIST1", "serial:/dev/ttyACM0"] {
        let (_, problem) = lines_of(&refused, device)?;
        let problem = problem.unwrap_or_default();
        ensure!(problem.contains("sudo usermod -aG dialout"), "{device}: {problem}");
    }
    println!("   mocapd devices, in the group dialout:\n{seen}   and in no group:\n{refused}");
    Ok("2 of 2 open to the group dialout; others get the command to join it".to_owned())
}

pub(crate) fn the_rule_solves_it() -> Measurement {
    set_rules(None)?;
    let device = Simulator::bulk("RULE1", &[])?;
    let seen = listing(User::Dialout)?;
    let problem = lines_of(&seen, &device.uri)?.1.context("it may be opened without a rule")?;
    let rule = problem.split('`').nth(1).context(problem.to_owned())?.to_owned();
    ensure!(rule.starts_with("SUBSYSTEM==\"usb\""), "{problem}");
    let refused = record(&device.uri, "/tmp/refused.take", &[])?;
    let refused = refused.finish(TIMEOUT)?.with_code(1)?;
    refused.mentions(&["no permission to open usb:1209:0001:RULE1", &rule])?;
    device.stop()?;
    wait_for_absence("RULE1")?;
    set_rules(Some(&rule))?;
    let device = Simulator::bulk("RULE1", &[])?;
    let seen = listing(User::Dialout)?;
    let problem = lines_of(&seen, &device.uri)?.1;
    ensure!(problem.is_none(), "with the line in place: {problem:?}");
    Ok("refused with the line, open with it in place".to_owned())
}

pub(crate) fn one_at_a_time() -> Measurement {
    let device = Simulator::bulk("BUSY1", &["--loop"])?;
    let mut first = record(&device.uri, "/tmp/first.take", &[])?;
    first.has_recorded("/tmp/first.take")?;
    let seen = listing(User::Dialout)?;
    let problem = lines_of(&seen, &device.uri)?.1.unwrap_or_default();
    ensure!(problem.contains("is in use by mocapd (process "), "{problem}");
    let second = record(&device.uri, "/tmp/second.take", &[])?;
    let second = second.finish(TIMEOUT)?.with_code(1)?;
    second.mentions(&["usb:1209:0001:BUSY1 is in use by mocapd (process "])?;
    first.interrupt()?;
    first.finish(TIMEOUT)?.with_code(0)?;
    Ok("the second reports the process that holds it".to_owned())
}

/// The kernel's generic serial driver has claimed the interface: it is detached for the recording and attached again.
pub(crate) fn kernel_driver() -> Measurement {
    const PORT: &str = "/dev/ttyUSB0";
    run("insmod", &["/modules/extra/usbserial.ko", "vendor=0x1209", "product=0x0001"])?;
    let measured = (|| {
        let device = Simulator::bulk("DRIVER1", &["--seconds", "1"])?;
        wait_for_port(PORT)?;
        let ran = record(&device.uri, "/tmp/driver.take", &[])?.finish(TIMEOUT)?.with_code(0)?;
        let ledger = LedgerReport::of(&ran.json()?)?;
        wait_for_port(PORT).context("the driver is not back")?;
        ledger.ensure_complete(&device.stop()?)?;
        Ok(format!("{} frames past usbserial, whose port is back", ledger.recorded))
    })();
    wait_for_absence("DRIVER1")?;
    run("rmmod", &["usbserial"])?;
    measured
}

pub(crate) fn no_gadget() -> Measurement {
    let serve = ["serve", "--generate", "jump", "--usb-gadget"];
    let refused = |user: User, more: &[&str], code: i32, facts: &[&str]| {
        let simulator = Mocapd::start_program("mocapd-sim", user, &[&serve, more].concat())?;
        simulator.finish(TIMEOUT)?.with_code(code)?.mentions(facts)
    };
    refused(User::Dialout, &[], 1, &["creating a USB gadget needs root"])?;
    refused(User::Root, &["--udc", "none.0"], 2, &["'none.0'", "dummy_udc.0, dummy_udc.1"])?;
    let _first = Simulator::bulk("BOTH1", &[])?;
    let second = Simulator::port("BOTH2", &[])?;
    refused(User::Root, &[], 1, &["no USB device controller is free", "--udc"])?;
    second.stop()?;
    wait_for_absence("BOTH2")?;
    let _again = Simulator::bulk("BOTH3", &["--udc", "dummy_udc.1"])?;
    Ok("not root, no such controller, none free: each reported".to_owned())
}

/// Another program's transfers use up the kernel's limit.
pub(crate) fn no_memory() -> Measurement {
    const LIMIT: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";
    let before = fs::read_to_string(LIMIT)?;
    let hog = MisbehavingDevice::start("HOG1", silent)?;
    let device = Simulator::bulk("MEM1", &["--loop"])?;
    let info = nusb::list_devices().wait()?.find(|info| info.serial_number() == Some("HOG1"));
    let interface = info.context("HOG1")?.open().wait()?.claim_interface(0).wait()?;
    let address = interface
        .descriptor()
        .and_then(|descriptor| descriptor.endpoints().map(|e| e.address()).find(|a| a & 0x80 != 0));
    let mut endpoint = interface.endpoint::<Bulk, In>(address.context("no endpoint")?)?;
    fs::write(LIMIT, "1")?;
    let mut held: Vec<Buffer> = Vec::new();
    for kib in [256, 64, 16, 4] {
        loop {
            let buffer = endpoint.allocate(kib << 10);
            if !buffer.is_zero_copy() {
                break;
            }
            held.push(buffer);
        }
    }
    let kib: usize = held.iter().map(Buffer::capacity).sum::<usize>() >> 10;
    let refused = record(&device.uri, "/tmp/memory.take", &[])?.finish(TIMEOUT);
    endpoint.cancel_all();
    drop(held);
    drop((endpoint, interface));
    fs::write(LIMIT, before.trim())?;
    refused?.with_code(1)?.mentions(&["1 MiB for all programs", "`echo 64 | sudo tee", LIMIT])?;
    let second = record(&device.uri, "/tmp/memory.take", &["--seconds", "500ms"])?;
    second.finish(Duration::from_secs(60))?.with_code(0)?;
    hog.stop()?;
    Ok(format!("reported with {kib} KiB of 1024 in use elsewhere; records once they are free"))
}
