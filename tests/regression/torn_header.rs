//! A take that fails before its first frame is on disk leaves no file, and no hint to recover it.

use mocapd_acquire::pipeline::NothingRecorded;

use crate::{
    cli::{Folder, devices::Simulated, service::Service},
    support::{assert_mentions, jump, mentions},
};

/// Limits files to 512 or 1024 bytes, depending on the shell.
const SHORT_FILES: &str = "trap '' XFSZ; ulimit -f 1";

/// A device whose header is longer than that.
fn with_long_header() -> Simulated {
    let mut motion = jump(1, 60.0, 2.0);
    for (i, marker) in motion.info.markers.iter_mut().enumerate() {
        marker.label = format!("{i:02}-{}", "x".repeat(120));
    }
    Simulated::endless(motion)
}

/// A device whose header is shorter, and whose first stretch is longer.
fn with_long_stretches() -> Simulated {
    Simulated::endless(jump(1, 1000.0, 2.0))
}

#[test]
fn the_service_removes_the_file_and_reports_it() {
    for device in [with_long_header(), with_long_stretches()] {
        let folder = Folder::new();
        let service = Service::start(&folder, &device, "lossless = true", SHORT_FILES);
        // Twice, since the name is free again.
        for _ in 0..2 {
            let (status, problem) = service.post("/v1/start", r#"{"name": "torn"}"#);
            assert_eq!((status, problem["kind"].as_str()), (507, Some("disk")), "{problem}");
            let message = problem["message"].as_str().unwrap();
            assert!(!message.contains("recover") && mentions(message, "torn"), "{message}");
            assert_eq!(folder.path("takes").read_dir().unwrap().count(), 0);
            assert_eq!(service.get("/v1/status")["failure"], message);
        }
    }
}

#[test]
fn record_removes_the_file_as_well() {
    for device in [with_long_header(), with_long_stretches()] {
        let folder = Folder::new();
        let line = folder.refused(
            {
                let mut command = std::process::Command::new("sh");
                let record = "exec \"$mocapd\" record -d \"$device\" -o torn.take --lossless --keep-free 0 --seconds 20s";
                command.args(["-c", &format!("{SHORT_FILES}\n{record}")]);
                command.env("mocapd", env!("CARGO_BIN_EXE_mocapd")).env("device", device.uri());
                command.current_dir(folder.path(""));
                command
            },
            1,
        );
        assert_mentions(&line, &[&NothingRecorded.to_string()]);
        assert!(!line.contains("mocapd recover"), "{line}");
    }
}
