//! The serial transport on a pty, which is a serial port except for its baud rate and modem lines.

#[cfg(test)]
mod serial_pty {
    use std::{
        fs::File,
        io::{Read, Write},
        path::PathBuf,
        time::{Duration, Instant},
    };

    use mocapd_drivers::{
        device::{Command, DeviceEvent, Hello},
        link::DeviceLink,
        registry::{self, OpenError},
        transport::{Transport, TransportError, serial::SerialTransport},
        uri::DeviceUri,
    };
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

    /// Opens a pty: the device's end, and the path of the host's.
    fn pty() -> (File, PathBuf) {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap();
        (master.into(), path.into_string().unwrap().into())
    }

    fn read_exactly(from: &mut dyn Transport, n: usize) -> Vec<u8> {
        let mut got = Vec::new();
        let mut buf = [0; 100];
        let give_up_at = Instant::now() + Duration::from_secs(5);
        while got.len() < n && Instant::now() < give_up_at {
            let n = from.read(&mut buf).unwrap();
            got.extend_from_slice(&buf[..n]);
        }
        got
    }

    #[test]
    fn carries_every_byte_both_ways() {
        let (mut device, path) = pty();
        let mut host = SerialTransport::open(&path, Some(921_600)).unwrap();
        let bytes = (0..=255).collect::<Vec<u8>>();
        device.write_all(&bytes).unwrap();
        assert_eq!(read_exactly(&mut host, 256), bytes);
        host.write_all(&bytes).unwrap();
        let mut got = [0; 256];
        device.read_exact(&mut got).unwrap();
        assert_eq!(got, bytes[..]);
    }

    #[test]
    fn a_read_without_data_times_out_without_error() {
        let (_device, path) = pty();
        let mut host = SerialTransport::open(&path, None).unwrap();
        let before = Instant::now();
        assert_eq!(host.read(&mut [0; 8]).unwrap(), 0);
        assert!(before.elapsed() >= Duration::from_millis(15), "{:?}", before.elapsed());
    }

    #[test]
    fn a_line_has_the_requested_speed() {
        let (_device, path) = pty();
        let unlimited = SerialTransport::open(&path, None).unwrap();
        assert_eq!(unlimited.line_bytes_per_s(), None);
        drop(unlimited);
        for baud in [115_200, 3_000_000, 12_345_678] {
            let line = SerialTransport::open(&path, Some(baud)).unwrap();
            assert_eq!(line.line_bytes_per_s(), Some(u64::from(baud) / 10));
            assert!(line.describe().contains(&format!("{baud} baud")), "{}", line.describe());
        }
    }

    #[test]
    fn the_baud_rate_changes_while_open_and_a_break_does_no_harm() {
        let (mut device, path) = pty();
        let mut host = SerialTransport::open(&path, Some(9_600)).unwrap();
        host.write_all(b"before").unwrap();
        for baud in [921_600, 1_228_739] {
            host.set_baud(baud).unwrap();
            assert_eq!(host.line_bytes_per_s(), Some(u64::from(baud) / 10));
            assert!(host.describe().contains(&format!("{baud} baud")), "{}", host.describe());
        }
        host.send_break().unwrap();
        host.write_all(b"after").unwrap();
        let mut got = [0; 11];
        device.read_exact(&mut got).unwrap();
        assert_eq!(&got, b"beforeafter");
    }

    #[test]
    fn a_vanished_device_is_disconnected() {
        let (device, path) = pty();
        let mut host = SerialTransport::open(&path, None).unwrap();
        drop(device);
        let read = host.read(&mut [0; 8]);
        assert!(matches!(read, Err(TransportError::Disconnected { .. })), "{read:?}");
        let write = host.write_all(b"x");
        assert!(matches!(write, Err(TransportError::Disconnected { .. })), "{write:?}");
        // While this end is open, no other pty can get the same name.
        let again = SerialTransport::open(&path, None);
        assert!(matches!(again, Err(TransportError::NotFound { .. })), "{again:?}");
    }

    #[test]
    fn a_port_in_use_is_busy_and_names_the_user() {
        let (_device, path) = pty();
        let first = SerialTransport::open(&path, None).unwrap();
        let second = SerialTransport::open(&path, None);
        let Err(TransportError::Busy { holder: Some(holder), .. }) = &second else {
            panic!("{second:?}");
        };
        assert!(holder.contains(&format!("process {}", std::process::id())), "{holder}");
        drop(first);
        SerialTransport::open(&path, None).unwrap();
    }

    #[test]
    fn a_device_that_reads_nothing_ends_a_write() {
        let (_device, path) = pty();
        let mut host = SerialTransport::open(&path, None).unwrap();
        let error = host.write_all(&[0x55; 1 << 20]).unwrap_err();
        assert!(matches!(error, TransportError::Stuck { .. }), "{error:?}");
    }

    #[test]
    fn a_device_uri_opens_and_the_device_identifies_itself() {
        let (mut device, path) = pty();
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("rig");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let uri: DeviceUri = format!("serial:{}", link.display()).parse().unwrap();
        let mut opened = registry::open(&uri).unwrap();
        assert_eq!(opened.family, "dvmc");

        let mut wire = Vec::new();
        opened.protocol.command(Command::Identify, &mut wire);
        opened.transport.write_all(&wire).unwrap();
        let mut received = vec![0; wire.len()];
        device.read_exact(&mut received).unwrap();
        let mut commands = Vec::new();
        let mut end = DeviceLink::new();
        end.push(&received, &mut |command| commands.push(command));
        assert_eq!(commands, [Command::Identify]);

        let hello =
            Hello { rate_millihertz: 1, rate_max_millihertz: 1, tick_hz: 1, ..Hello::default() };
        let mut answer = Vec::new();
        end.hello(&hello, &mut answer).unwrap();
        device.write_all(&answer).unwrap();
        let mut n_events = 0;
        let bytes = read_exactly(opened.transport.as_mut(), answer.len());
        opened.protocol.push(&bytes, &mut |event| {
            assert_eq!(event, DeviceEvent::Hello(&hello));
            n_events += 1;
        });
        assert_eq!(n_events, 1);

        let busy = registry::open(&uri);
        assert!(matches!(busy, Err(OpenError::Transport(TransportError::Busy { .. }))), "{busy:?}");
    }
}
