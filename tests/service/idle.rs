//! An idle service wakes rarely.

use std::{fs, time::Duration};

use crate::{
    cli::{Folder, devices::Simulated, service::Service},
    support::jump,
};

/// Voluntary context switches of all threads of a process.
fn voluntary_switches(pid: u32) -> u64 {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).unwrap().flatten();
    let of_thread = |status: String| {
        let line = status.lines().find(|line| line.starts_with("voluntary_ctxt_switches"))?;
        line.split_whitespace().last()?.parse::<u64>().ok()
    };
    // A thread may end in the meantime.
    let status = threads.filter_map(|thread| fs::read_to_string(thread.path().join("status")).ok());
    status.filter_map(of_thread).sum::<u64>()
}

#[test]
fn an_idle_service_wakes_at_most_ten_times_a_second() {
    const SECONDS: u64 = 4;
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let trigger = "[trigger]\nlisten = '127.0.0.1:0'\nsend_to = ['127.0.0.1:9']";
    let mut service = Service::start(&folder, &device, trigger, "");
    assert_eq!(service.post("/v1/disarm", "{}").0, 200);
    service.wait_until("idle", |status| status["state"] == "idle");
    // Let the disarm finish.
    std::thread::sleep(Duration::from_secs(1));
    let before = voluntary_switches(service.pid());
    std::thread::sleep(Duration::from_secs(SECONDS));
    let woken = voluntary_switches(service.pid()) - before;
    assert!(woken <= 10 * SECONDS, "{woken} times in {SECONDS} s");
    // It still responds to commands.
    assert_eq!(service.post("/v1/start", r#"{"name": "walk"}"#).0, 200);
    assert_eq!(service.post("/v1/stop", "{}").0, 200);
}
