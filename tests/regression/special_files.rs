//! A path to a pipe or a device is refused at once; the program does not wait for it.

use std::{
    os::unix::{fs::symlink, net::UnixListener},
    process::{Child, Command},
    time::{Duration, Instant},
};

use mocapd_drivers::plain_file::NotAFile;

use crate::cli::{Folder, Ran};

/// Far longer than a refusal takes on any machine; a read from the pipe would block forever.
const WITHIN: Duration = Duration::from_secs(60);

/// Kills a program that does not end.
fn ended(mut child: Child) -> Option<Ran> {
    let begun = Instant::now();
    while begun.elapsed() < WITHIN {
        if child.try_wait().unwrap().is_some() {
            return Some(child.wait_with_output().unwrap().into());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    None
}

/// A folder in which each extension leads to something other than a file.
fn folder() -> (Folder, UnixListener) {
    let folder = Folder::new();
    for ending in ["take", "c3d", "csv", "toml", "json", "obj", "png", "token"] {
        let made = Command::new("mkfifo").arg(folder.path(&format!("pipe.{ending}"))).status();
        assert!(made.unwrap().success());
        // Never to be read: it has no end.
        symlink("/dev/zero", folder.path(&format!("device.{ending}"))).unwrap();
        symlink("socket", folder.path(&format!("socket.{ending}"))).unwrap();
    }
    let listener = UnixListener::bind(folder.path("socket")).unwrap();
    (folder, listener)
}

#[test]
fn pipes_devices_and_sockets_are_refused_at_once() {
    let (folder, _listener) = folder();
    folder.write_motion("jump.csv", &crate::support::jump(1, 30.0, 1.0));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    for (what, kind) in
        [("pipe", NotAFile::Pipe), ("device", NotAFile::Device), ("socket", NotAFile::Socket)]
    {
        let named = |ending: &str| format!("{what}.{ending}");
        let [take, c3d, csv, toml] = ["take", "c3d", "csv", "toml"].map(named);
        let [json, obj, png, token] = ["json", "obj", "png", "token"].map(named);
        let commands: [&[&str]; 17] = [
            &["info", &take],
            &["verify", &take],
            &["verify", "jump.take", "--against", &take],
            &["verify", "jump.take", "--against", &csv],
            &["verify", "jump.take", "--skeleton", &json],
            &["recover", &take, "-o", "new.take"],
            &["export", &take, "-o", "new.csv"],
            &["import", &c3d, "-o", "new.take"],
            &["import", &csv, "-o", "new.take"],
            &["import", "jump.csv", "-o", "new.take", "--skeleton", &json],
            &["plot", "trajectory", &take, "-o", "new.svg"],
            &["bench", "codec", &csv],
            &["config", "check", &toml],
            &["run", "--config", &toml],
            &["subject", "body", &obj, "-o", "new.json"],
            &["subject", "face", &png, "-o", "new.json"],
            &["ctl", "--connect", "http://127.0.0.1:1", "--token-file", &token, "status"],
        ];
        for args in commands {
            let ran = ended(folder.command(args).spawn().unwrap());
            let Some(ran) = ran else { panic!("{args:?} did not end") };
            assert!(matches!(ran.code, Some(1 | 2)), "{args:?}: {ran:?}");
            assert_eq!(
                ran.stderr.matches(&kind.to_string()).count(),
                1,
                "{args:?}: {}",
                ran.stderr
            );
        }
    }
    assert!(!folder.path("new.take").exists());
}
