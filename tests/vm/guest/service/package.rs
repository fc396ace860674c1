//! The Debian package: installation, upgrade and removal.

use std::{fs, os::unix::fs::MetadataExt, path::Path};

use anyhow::{Context, ensure};

use super::rig::{TAKES, TIMEOUT, UNIT, User, configure, id_of, ok, run, show, start, stdout_of};
use crate::{Measurement, attached::wait_until};

const PACKAGE: &str = "/opt/mocapd.deb";

/// Upper limit of the unit's exposure, by `systemd-analyze security`.
const EXPOSURE_MAX: f64 = 1.5;

/// Mode, user and group of a file.
fn owned(path: &str) -> anyhow::Result<(u32, u32, u32)> {
    let meta = fs::metadata(path).with_context(|| path.to_owned())?;
    Ok((meta.mode() & 0o7777, meta.uid(), meta.gid()))
}

pub(crate) fn installs() -> Measurement {
    ok("dpkg", &["-i", PACKAGE])?;
    let status = ok("dpkg-query", &["-W", "-f", "${Status} ${Version}", "mocapd"])?;
    ensure!(status.starts_with("install ok installed"), "{status}");
    let (user, group) = (id_of("mocapd", "/etc/passwd")?, id_of("mocapd", "/etc/group")?);
    ensure!((1..1000).contains(&user), "a system user: {user}");
    for folder in ["/var/lib/mocapd", "/run/mocapd"] {
        ensure!(owned(folder)? == (0o750, 0, group), "{folder}: {:?}", owned(folder)?);
    }
    ensure!(Path::new("/etc/mocapd/example.toml").exists(), "no example");
    let conf_files = ok("dpkg-query", &["-W", "-f", "${Conffiles}", "mocapd"])?;
    ensure!(conf_files.contains("/etc/mocapd/example.toml"), "no conffile: {conf_files}");
    let files = ok("dpkg", &["-L", "mocapd"])?;
    Ok(format!(
        "{}, {} files and folders",
        status.rsplit(' ').next().unwrap_or("?"),
        files.lines().count()
    ))
}

pub(crate) fn units() -> Measurement {
    for unit in ["mocapd@sim.service", "mocapd-sim@sim.service"] {
        // Without --recursive-errors an unknown key is not an error. The machine has no `man` to check pages with.
        let arguments = ["verify", "--recursive-errors=no", "--man=no", unit];
        let output = run(User::Root, "systemd-analyze", &arguments)?;
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        stdout_of(&output, "systemd-analyze", &arguments)?;
        ensure!(stderr.is_empty(), "{unit}: {stderr}");
    }
    configure("")?;
    start()?;
    let mut figures = Vec::new();
    for unit in ["mocapd@sim.service", "mocapd-sim@sim.service"] {
        let table = ok("systemd-analyze", &["security", "--no-pager", unit])?;
        let last =
            table.lines().rfind(|line| line.contains("exposure level")).context(table.clone())?;
        let figure = last.split(':').nth(1).and_then(|text| text.split_whitespace().next());
        let figure: f64 = figure.context(last.to_owned())?.parse()?;
        ensure!(figure < EXPOSURE_MAX, "{last}");
        figures.push(format!("{unit} {figure}"));
    }
    Ok(format!("exposure: {}", figures.join(", ")))
}

pub(crate) fn manual() -> Measurement {
    let pages = pages_and_completions("mocapd")? + pages_and_completions("mocapd-sim")?;
    Ok(format!("{pages} pages, and three shells know their commands"))
}

/// Checks that every command of a program has a page and is completed; returns how many there are.
fn pages_and_completions(program: &str) -> anyhow::Result<usize> {
    let help = ok(program, &["--help"])?;
    let commands: Vec<_> = help
        .lines()
        .skip_while(|line| !line.starts_with("Commands:"))
        .skip(1)
        .take_while(|line| line.starts_with("  "))
        // Longer descriptions continue on a line with a deeper indent.
        .filter_map(|line| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|&name| name != "help")
        .collect();
    for expected in ["completions", "man"] {
        ensure!(commands.contains(&expected), "{help}");
    }
    for name in &commands {
        let page = format!("/usr/share/man/man1/{program}-{name}.1.gz");
        ensure!(Path::new(&page).exists(), "no {page}");
    }
    for file in [
        format!("bash-completion/completions/{program}"),
        format!("zsh/vendor-completions/_{program}"),
        format!("fish/vendor_completions.d/{program}.fish"),
    ] {
        let path = Path::new("/usr/share").join(&file);
        let text = fs::read_to_string(path).with_context(|| file.clone())?;
        for name in &commands {
            ensure!(text.contains(name), "{file} knows no {name}");
        }
    }
    ok("bash", &["-n", &format!("/usr/share/bash-completion/completions/{program}")])?;
    Ok(commands.len())
}

pub(crate) fn doctor() -> Measurement {
    configure("")?;
    start()?;
    let seen = |user| -> anyhow::Result<String> {
        let output = run(user, "mocapd", &["doctor", "--dir", "/tmp"])?;
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let member = seen(User::Member)?;
    let line = |text: &str, what: &str| -> anyhow::Result<String> {
        let found = text.lines().find(|line| line.contains(what));
        Ok(found.with_context(|| format!("no '{what}' in: {text}"))?.to_owned())
    };
    let service = line(&member, "mocapd@sim")?;
    ensure!(service.starts_with("good") && service.contains("running"), "{service}");
    ensure!(line(&member, "sudo systemctl enable mocapd@sim").is_ok(), "{member}");
    let stranger = seen(User::Stranger)?;
    line(&stranger, "sudo usermod -aG mocapd")?;
    ok("systemctl", &["stop", UNIT])?;
    let stopped = seen(User::Member)?;
    line(&stopped, "sudo systemctl enable --now mocapd@sim")?;
    Ok(service.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// An upgrade keeps edited files and interrupts no take; a removal stops the service and keeps takes.
pub(crate) fn removed() -> Measurement {
    let example = "/etc/mocapd/example.toml";
    let edited = format!("{}\n# edited\n", fs::read_to_string(example)?);
    fs::write(example, &edited)?;
    configure("")?;
    start()?;
    let pid = show(UNIT, "MainPID")?;
    let stdout = ok("dpkg", &["-i", PACKAGE])?;
    ensure!(show(UNIT, "MainPID")? == pid, "an upgrade restarted it");
    ensure!(stdout.contains("systemctl restart mocapd@sim.service"), "{stdout}");
    ensure!(fs::read_to_string(example)? == edited, "the edited file is gone");
    ok("dpkg", &["-r", "mocapd"])?;
    wait_until("the service's end", TIMEOUT, || {
        (show(UNIT, "ActiveState").ok()? != "active").then_some(())
    })?;
    ensure!(!Path::new("/usr/bin/mocapd").exists(), "the program is there");
    ensure!(fs::read_to_string(example)? == edited, "a removal took the configuration");
    let takes = super::rig::takes()?.len();
    ensure!(takes > 0, "no take to keep");
    let stdout = ok("dpkg", &["-P", "mocapd"])?;
    ensure!(super::rig::takes()?.len() == takes, "a purge took takes");
    ensure!(stdout.contains("takes in /var/lib/mocapd are kept"), "{stdout}");
    ensure!(!Path::new(example).exists(), "a purge left the example");
    Ok(format!("{takes} takes kept in {TAKES}"))
}
