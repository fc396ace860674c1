//! Plugging in a rig: udev starts its service, whose sandbox admits the device.

use std::{fs, path::Path, thread::sleep, time::Duration};

use anyhow::{Context, ensure};

use super::rig::{Rig, TIMEOUT, User, frames, ok, run, show};
use crate::{Measurement, attached::wait_until, simulator::Simulator};

/// Loads kernel modules, which make the guest's kernel a USB device; all of them if `names` is empty.
fn load(names: &[&str]) -> anyhow::Result<()> {
    let mut modules: Vec<_> =
        fs::read_dir("/modules")?.flatten().map(|entry| entry.path()).collect();
    modules.sort();
    for module in modules.iter().filter(|path| path.extension().is_some_and(|end| end == "ko")) {
        let stem = module.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let name = stem.split_once('-').map_or("", |(_, name)| name);
        let is_loaded = Path::new("/sys/module").join(name).exists();
        let is_wanted = names.is_empty() || names.contains(&name);
        if is_wanted && !is_loaded {
            let parameters = fs::read_to_string(module.with_extension("parameters"))?;
            let parameters: Vec<_> = parameters.split_whitespace().collect();
            let path = module.display().to_string();
            ok("insmod", &[&[path.as_str()], &parameters[..]].concat())?;
        }
    }
    if !Path::new("/sys/kernel/config/usb_gadget").exists() {
        run(User::Root, "mount", &["-t", "configfs", "c", "/sys/kernel/config"])?;
    }
    Ok(())
}

const WITHOUT_PORTS: &[&str] =
    &["usb_common", "usbcore", "udc_core", "dummy_hcd", "configfs", "libcomposite", "usb_f_fs"];

const BULK: Rig = Rig { name: "RIG0001", port: 8990 };
const PORT: Rig = Rig { name: "PORT0001", port: 8991 };

/// Writes the configuration of a rig, with its own port for triggers.
fn configure(rig: Rig, uri: &str) -> anyhow::Result<()> {
    let text = format!(
        "[device]\nuri = \"{uri}\"\n[trigger]\nlisten = \"127.0.0.1:{}\"\n[http]\nlisten = \"\"\n",
        rig.port
    );
    Ok(fs::write(format!("/etc/mocapd/{}.toml", rig.name), text)?)
}

/// Records a take; `code` is the exit code: 3 if frames are missing.
fn records(rig: Rig, code: i32) -> anyhow::Result<u64> {
    let take = rig.begin()?;
    sleep(Duration::from_secs(2));
    rig.end(code)?;
    let n = frames(&take, code)?;
    ensure!(n > 50, "{n} frames");
    Ok(n)
}

fn wait_for(unit: &str, state: &str) -> anyhow::Result<()> {
    wait_until(&format!("{unit} {state}"), TIMEOUT, || {
        (show(unit, "ActiveState").ok()? == state).then_some(())
    })
}

pub(crate) fn starts() -> Measurement {
    load(WITHOUT_PORTS)?;
    configure(BULK, "usb:1209:0001:RIG0001")?;
    // A rig without a configuration starts nothing.
    let other = Simulator::bulk("RIG0002", &["--loop"])?;
    let rig = Simulator::bulk("RIG0001", &["--loop"])?;
    wait_for("mocapd@RIG0001", "active")?;
    ensure!(show("mocapd@RIG0002", "ActiveState")? == "inactive", "a rig without a configuration");
    let n_frames = records(BULK, 0)?;
    let pid = show("mocapd@RIG0001", "MainPID")?;
    let take = BULK.begin()?;
    let (controller, _) = rig.unplug()?;
    sleep(Duration::from_secs(2));
    rig.plug(&controller)?;
    sleep(Duration::from_secs(4));
    // The frames sent meanwhile are missing, and the take continued.
    BULK.end(3)?;
    let over_the_gap = frames(&take, 3)?;
    ensure!(over_the_gap > 0, "nothing of it is in the take");
    ensure!(show("mocapd@RIG0001", "MainPID")? == pid, "unplugging ended the service");
    records(BULK, 0).context("after it was plugged in again")?;
    rig.stop()?;
    other.stop()?;
    Ok(format!(
        "udev started it; {n_frames} frames through the sandbox; unplugged and plugged in again"
    ))
}

/// The service runs before the port's driver is loaded, when its sandbox cannot know such a device yet.
pub(crate) fn driver_comes_later() -> Measurement {
    let was_loaded = Path::new("/sys/module/cdc_acm").exists();
    ensure!(!was_loaded, "the driver is there already: this shows nothing");
    configure(PORT, "serial:/dev/ttyACM0")?;
    ok("systemctl", &["start", "mocapd@PORT0001"])?;
    load(&[])?;
    let rig = Simulator::port("PORT0001", &["--loop"])?;
    let frames = records(PORT, 0)?;
    rig.stop()?;
    Ok(format!("{frames} frames through a port that came after the service"))
}
