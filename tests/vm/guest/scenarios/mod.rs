//! The USB scenarios, in order.

mod access;
mod bad;
mod ndi;
mod recording;
mod replug;
mod speed;

use crate::Scenario;

pub(crate) const ALL: &[(&str, Scenario)] = &[
    ("devices: both listed with our rules", access::listed_with_our_rules),
    ("devices: the udev rule shown solves it", access::the_rule_solves_it),
    ("devices: one program at a time", access::one_at_a_time),
    ("devices: a kernel driver is detached", access::kernel_driver),
    ("devices: no memory for transfers", access::no_memory),
    ("simulator: why it cannot be a device", access::no_gadget),
    ("record: bulk", recording::bulk),
    ("record: CDC-ACM", recording::port),
    ("record: two devices at once", recording::two_at_once),
    ("record: one motion by both", recording::one_motion),
    ("record: NDI over CDC-ACM", ndi::recorded),
    ("replug: bulk", replug::bulk),
    ("replug: CDC-ACM", replug::port),
    ("replug: without udev", replug::without_udev),
    ("replug: after a loss of power", replug::power_cut),
    ("replug: another serial number", replug::another),
    ("replug: NDI over CDC-ACM", ndi::replugged),
    ("replug: never", replug::never),
    ("bad: stalls now and then", bad::stalls),
    ("bad: stalls for good", bad::stalls_for_good),
    ("bad: sends nothing", bad::sends_nothing),
    ("bad: sends garbage", bad::sends_garbage),
    ("bad: lies in its descriptors", bad::lies),
    ("bad: vanishes inside a transfer", bad::vanishes),
    ("bad: answers late", bad::answers_late),
    ("speed: the transport and a bare loop", speed::transport),
    ("speed: the whole pipeline", speed::pipeline),
];

/// Scenarios that run only when named.
pub(crate) const LONG: &[(&str, Scenario)] = &[
    ("replug: the recorder alone", replug::alone),
    ("speed: the transport alone", speed::transport_alone),
    ("speed: the heaviest load", speed::heaviest_load),
];
