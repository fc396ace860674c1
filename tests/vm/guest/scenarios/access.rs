//! Who may open a device, and what stands in the way.

use std::{fs, time::Duration};

use anyhow::{Context, ensure};
use nusb::{
    MaybeFuture,
    transfer::{Buffer, Bulk, In},
};

use crate::{
    Measured,
    attached::{PATIENCE, run, set_rules, wait_for_absence, wait_for_port},
    ledger::Account,
    odd::{Odd, mute},
    recorder::{Mocapd, User, mocapd, record},
    simulator::Simulator,
};

fn listing(user: User) -> anyhow::Result<String> {
    Ok(mocapd(user, &["devices"])?.with_code(0)?.stdout)
}

/// The lines of a device: its own, and the one behind it when there is one.
fn lines_of<'a>(listing: &'a str, device: &str) -> anyhow::Result<(&'a str, Option<&'a str>)> {
    let mut lines = listing.lines().skip_while(|line| !line.starts_with(device));
    let line = lines.next().with_context(|| format!("{device} is not in: {listing}"))?;
    Ok((line, lines.next().filter(|line| line.starts_with(' '))))
}

pub(crate) fn listed_with_our_rules() -> Measured {
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
    Ok("2 of 2 open to the group dialout; others are told to join it".to_owned())
}

pub(crate) fn the_line_mends_it() -> Measured {
    set_rules(None)?;
    let device = Simulator::bulk("RULE1", &[])?;
    let seen = listing(User::Dialout)?;
    let problem = lines_of(&seen, &device.uri)?.1.context("it may be opened without a rule")?;
    let rule = problem.split('`').nth(1).context(problem.to_owned())?.to_owned();
    ensure!(rule.starts_with("SUBSYSTEM==\"usb\""), "{problem}");
    let refused = record(&device.uri, "/tmp/refused.take", &[])?;
    let refused = refused.finish(PATIENCE)?.with_code(1)?;
    refused.says(&["no permission for usb:1209:0001:RULE1", &rule])?;
    device.stop()?;
    wait_for_absence("RULE1")?;
    set_rules(Some(&rule))?;
    let device = Simulator::bulk("RULE1", &[])?;
    let seen = listing(User::Dialout)?;
    let problem = lines_of(&seen, &device.uri)?.1;
    ensure!(problem.is_none(), "with the line in place: {problem:?}");
    Ok("refused with the line, open with it in place".to_owned())
}

pub(crate) fn one_at_a_time() -> Measured {
    let device = Simulator::bulk("BUSY1", &["--loop"])?;
    let mut first = record(&device.uri, "/tmp/first.take", &[])?;
    first.has_recorded("/tmp/first.take")?;
    let seen = listing(User::Dialout)?;
    let problem = lines_of(&seen, &device.uri)?.1.unwrap_or_default();
    ensure!(problem.contains("is in use by mocapd (process "), "{problem}");
    let second = record(&device.uri, "/tmp/second.take", &[])?;
    let second = second.finish(PATIENCE)?.with_code(1)?;
    second.says(&["usb:1209:0001:BUSY1 is in use by mocapd (process "])?;
    first.interrupt()?;
    first.finish(PATIENCE)?.with_code(0)?;
    Ok("the second is told who holds it".to_owned())
}

/// The kernel's driver for any serial device takes the interface; it gives it to us, and gets it back.
pub(crate) fn kernel_driver() -> Measured {
    const PORT: &str = "/dev/ttyUSB0";
    run("insmod", &["/modules/extra/usbserial.ko", "vendor=0x1209", "product=0x0001"])?;
    let measured = (|| {
        let device = Simulator::bulk("DRIVER1", &["--seconds", "1"])?;
        wait_for_port(PORT)?;
        let ran = record(&device.uri, "/tmp/driver.take", &[])?.finish(PATIENCE)?.with_code(0)?;
        let account = Account::of(&ran.json()?)?;
        wait_for_port(PORT).context("the driver is not back")?;
        account.has_all_of(&device.stop()?)?;
        Ok(format!("{} frames past usbserial, whose port is back", account.recorded))
    })();
    wait_for_absence("DRIVER1")?;
    run("rmmod", &["usbserial"])?;
    measured
}

pub(crate) fn no_gadget() -> Measured {
    let serve = ["serve", "--generate", "jump", "--usb-gadget"];
    let refused = |user: User, more: &[&str], code: i32, words: &[&str]| {
        let simulator = Mocapd::start_program("mocapd-sim", user, &[&serve, more].concat())?;
        simulator.finish(PATIENCE)?.with_code(code)?.says(words)
    };
    refused(User::Dialout, &[], 1, &["creating a USB gadget needs root"])?;
    refused(User::Root, &["--udc", "none.0"], 2, &["'none.0'", "dummy_udc.0, dummy_udc.1"])?;
    let _first = Simulator::bulk("BOTH1", &[])?;
    let second = Simulator::port("BOTH2", &[])?;
    refused(User::Root, &[], 1, &["no USB device controller is free", "--udc"])?;
    second.stop()?;
    wait_for_absence("BOTH2")?;
    let _again = Simulator::bulk("BOTH3", &["--udc", "dummy_udc.1"])?;
    Ok("not root, no such controller, none free: each told".to_owned())
}

/// Another program's transfers use up the kernel's limit.
pub(crate) fn no_memory() -> Measured {
    const LIMIT: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";
    let before = fs::read_to_string(LIMIT)?;
    let hog = Odd::start("HOG1", mute)?;
    let device = Simulator::bulk("MEM1", &["--loop"])?;
    let info = nusb::list_devices().wait()?.find(|info| info.serial_number() == Some("HOG1"));
    let interface = info.context("HOG1")?.open().wait()?.claim_interface(0).wait()?;
    let address = interface
        .descriptor()
        .and_then(|said| said.endpoints().map(|e| e.address()).find(|a| a & 0x80 != 0));
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
    let refused = record(&device.uri, "/tmp/memory.take", &[])?.finish(PATIENCE);
    endpoint.cancel_all();
    drop(held);
    drop((endpoint, interface));
    fs::write(LIMIT, before.trim())?;
    refused?.with_code(1)?.says(&["1 MiB for all programs", "`echo 64 | sudo tee", LIMIT])?;
    let second = record(&device.uri, "/tmp/memory.take", &["--seconds", "500ms"])?;
    second.finish(Duration::from_secs(60))?.with_code(0)?;
    hog.stop()?;
    Ok(format!("told with {kib} KiB of 1024 held by another program; records when they are free"))
}
