//! The network, for devices on it: buffers for datagrams, interfaces, and firewalls as far as a user can see them.

use std::{
    fs,
    process::{Command, Stdio},
};

use mocapd_drivers::transport::network::{self, Interface};

use super::Finding;

/// Largest receive buffer that a program may have, in bytes.
const RECEIVE_BUFFER_MAX: &str = "/proc/sys/net/core/rmem_max";

/// What mocapd asks for: a second of 200 markers at 1000 Hz.
const RECEIVE_BUFFER_BYTES: u64 = 4 << 20;

pub(super) fn examine(report: &mut dyn FnMut(Finding)) {
    let stated = fs::read_to_string(RECEIVE_BUFFER_MAX).ok();
    if let Some(bytes) = stated.and_then(|text| text.trim().parse().ok()) {
        report(receive_buffers(bytes));
    }
    let found = network::interfaces().unwrap_or_default();
    let beyond = found.into_iter().filter(|interface| !interface.address.is_loopback());
    report(interfaces(&beyond.collect::<Vec<_>>()));
    let ufw = fs::read_to_string("/etc/ufw/ufw.conf").unwrap_or_default();
    report(firewall(&ufw, is_active("firewalld")));
}

fn receive_buffers(bytes: u64) -> Finding {
    let what = "datagram buffers";
    let seen = format!("net.core.rmem_max is {} KiB", bytes >> 10);
    if bytes >= RECEIVE_BUFFER_BYTES {
        return Finding::good(what, seen);
    }
    Finding::note(
        what,
        format!(
            "{seen}: with transport=udp a busy machine may lose datagrams; \
             `sudo sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` lets mocapd buffer a second"
        ),
    )
}

fn interfaces(interfaces: &[Interface]) -> Finding {
    let what = "network";
    if interfaces.is_empty() {
        let seen = "no interface is up: a device on the network cannot be reached; connect the cable, `ip address` lists \
                    the interfaces";
        return Finding::note(what, seen);
    }
    let one = |interface: &Interface| {
        let without = if interface.has_multicast { "" } else { ", no multicast" };
        format!("{} {}{without}", interface.name, interface.address)
    };
    Finding::good(what, interfaces.iter().map(one).collect::<Vec<_>>().join("; "))
}

/// Whether a unit is active; `false` without systemd.
fn is_active(unit: &str) -> bool {
    let mut command = Command::new("systemctl");
    command.args(["is-active", "--quiet", unit]);
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}

/// Only root can list the rules of a firewall.
fn firewall(ufw_conf: &str, has_firewalld: bool) -> Finding {
    let what = "firewall";
    let has_ufw = ufw_conf.lines().any(|line| line.trim().eq_ignore_ascii_case("ENABLED=yes"));
    let (name, command) = match (has_ufw, has_firewalld) {
        (true, _) => ("ufw", "`sudo ufw allow from ADDRESS proto udp to any`"),
        (_, true) => (
            "firewalld",
            "`sudo firewall-cmd --add-rich-rule='rule family=ipv4 source address=ADDRESS accept'`",
        ),
        _ => return Finding::good(what, "neither ufw nor firewalld is on"),
    };
    Finding::note(
        what,
        format!(
            "{name} is on: {command} lets in the datagrams of a QTM at ADDRESS (transport=udp); by TCP nothing is needed"
        ),
    )
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn small_buffers_name_the_command() {
        let small = receive_buffers(212_992);
        assert_eq!(small.verdict, Verdict::Note);
        assert!(small.seen.contains("208 KiB") && small.seen.contains("rmem_max=4194304"));
        assert_eq!(receive_buffers(4 << 20).verdict, Verdict::Good);
    }

    #[test]
    fn interfaces_are_listed_with_what_they_lack() {
        let network = |name: &str, has_multicast| Interface {
            name: name.to_owned(),
            address: Ipv4Addr::new(10, 0, 0, 2),
            broadcast: Some(Ipv4Addr::new(10, 0, 0, 255)),
            has_multicast,
        };
        let two = interfaces(&[network("eth0", true), network("tun0", false)]);
        assert_eq!(two.seen, "eth0 10.0.0.2; tun0 10.0.0.2, no multicast");
        assert_eq!(interfaces(&[]).verdict, Verdict::Note);
    }

    #[test]
    fn a_firewall_that_is_on_names_the_command() {
        assert_eq!(firewall("# ENABLED=yes or no\nENABLED=no\n", false).verdict, Verdict::Good);
        assert!(firewall("ENABLED=yes\n", false).seen.contains("sudo ufw allow"));
        assert!(firewall("", true).seen.contains("firewall-cmd"));
    }
}
