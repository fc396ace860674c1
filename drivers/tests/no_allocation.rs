//! After the largest frame, neither end of the link allocates, nor does an NDI host while it
//! polls.

#![expect(unsafe_code, reason = "counting allocations takes an allocator")]

#[cfg(test)]
mod no_allocation {
    use std::{
        alloc::{GlobalAlloc, Layout, System},
        cell::Cell,
        hint::black_box,
    };

    use mocapd_drivers::{
        device::{
            BodyInfo, Command, DeviceEvent, Frame, Hello, MarkerInfo, MarkerSample, Pong, Pose,
            PoseFrame, PoseStatus, Protocol, SampleBatch, SampleForm, SampledChannelInfo,
            SampledGroupInfo, Status,
        },
        link::{DeviceLink, FrameForm, HostLink},
        ndi::{NdiHost, crc16},
        qtm::{
            BodySettings, ClientId, FrameHeader, QtmHost, QtmServer, ServedBody, ServedFrame,
            ServedSettings, WireMarker,
        },
        transport::polled::{LineCommand, LineCommandReceiver, line_command_channel},
        uri::DeviceUri,
    };

    thread_local! {
        /// Allocations of this thread; the test harness allocates on others.
        static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
    }

    struct Counting;

    // SAFETY: every call is forwarded unchanged to the system's allocator.
    unsafe impl GlobalAlloc for Counting {
        unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
            ALLOCATIONS.set(ALLOCATIONS.get() + 1);
            // SAFETY: the caller upholds alloc's contract.
            unsafe { System.alloc(layout) }
        }

        unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
            // SAFETY: the pointer came from `alloc` above, with this layout.
            unsafe { System.dealloc(pointer, layout) }
        }

        unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
            ALLOCATIONS.set(ALLOCATIONS.get() + 1);
            // SAFETY: the caller upholds realloc's contract.
            unsafe { System.realloc(pointer, layout, bytes) }
        }
    }

    #[global_allocator]
    static COUNTING: Counting = Counting;

    struct LinkPair {
        device: DeviceLink,
        host: HostLink,
        wire: Vec<u8>,
        hello: Hello,
        table: Vec<MarkerInfo>,
        markers: Vec<MarkerSample>,
        group: SampledGroupInfo,
        samples: Vec<f32>,
        bodies: Vec<BodyInfo>,
        poses: Vec<Pose>,
    }

    impl LinkPair {
        fn round(&mut self, seq: u32) {
            self.wire.clear();
            for form in [FrameForm::Float, FrameForm::Micrometres, FrameForm::Compact] {
                let frame =
                    Frame { seq, device_ticks: 1, timecode: Some([1; 4]), markers: &self.markers };
                self.device.frame(form, &frame, &mut self.wire).unwrap();
            }
            self.device.hello(&self.hello, &mut self.wire).unwrap();
            self.device.markers(&self.table, &mut self.wire).unwrap();
            self.device.sampled_group(&self.group, &mut self.wire).unwrap();
            for form in [SampleForm::Int16, SampleForm::Int32, SampleForm::Float32] {
                let batch = SampleBatch {
                    group: 0,
                    number: seq,
                    first: 40 * u64::from(seq),
                    device_ticks: 1,
                    form,
                    n_channels: 2,
                    samples: &self.samples,
                };
                self.device.samples(&batch, &mut self.wire).unwrap();
            }
            self.device.bodies(&self.bodies, &mut self.wire).unwrap();
            let poses = PoseFrame { seq, number: seq, device_ticks: 1, poses: &self.poses };
            self.device.poses(&poses, &mut self.wire).unwrap();
            self.device.status(Status::default(), &mut self.wire);
            self.device.pong(Pong { host_ns: 1, device_ticks: 2 }, &mut self.wire);
            let mut n_events = 0;
            for piece in self.wire.chunks(1000) {
                self.host.push(piece, &mut |event| {
                    black_box(event);
                    n_events += 1;
                });
            }
            assert!(n_events >= 13);
            self.wire.clear();
            self.host.command(Command::Ping { host_ns: 1 }, &mut self.wire);
            let mut n_commands = 0;
            self.device.push(&self.wire, &mut |_| n_commands += 1);
            assert_eq!(n_commands, 1);
        }
    }

    #[test]
    fn after_the_first_round_nothing_is_allocated() {
        let marker = |id: u16| MarkerSample {
            id,
            occluded: id % 7 == 3,
            residual_10um: 4,
            position_mm: [f32::from(id), -1.5, 900.0],
        };
        let info = |id: u16| MarkerInfo { id, label: format!("marker {id}"), labelled: true };
        let hello = Hello {
            model: "model".to_owned(),
            rate_millihertz: 1,
            rate_max_millihertz: 1,
            tick_hz: 1,
            ..Hello::default()
        };
        let mut pair = LinkPair {
            device: DeviceLink::new(),
            host: HostLink::new(),
            wire: Vec::new(),
            hello,
            table: (0..300).map(info).collect(),
            markers: (0..300).map(marker).collect(),
            group: SampledGroupInfo {
                rate_millihertz: 2_000_000,
                channels: vec![SampledChannelInfo { scale: 1.0, ..Default::default() }; 2],
                ..SampledGroupInfo::default()
            },
            samples: (0..80_u8).map(f32::from).collect(),
            bodies: (0..128).map(|id| BodyInfo { id, name: format!("body {id}") }).collect(),
            poses: (0..128).map(|body| Pose::without(body, PoseStatus::Tracked)).collect(),
        };
        pair.round(0);
        let before = ALLOCATIONS.get();
        assert!(before > 0, "the allocator does not count");
        for seq in 1..50 {
            pair.round(seq);
        }
        assert_eq!(ALLOCATIONS.get(), before);
    }

    /// A scripted NDI system: set up immediately, then the same tool and strays in every frame.
    fn ndi_reply(request: &[u8], number: u32, out: &mut Vec<u8>) {
        out.clear();
        let mut text = |text: &[u8]| {
            out.extend_from_slice(text);
            let crc = crc16(text);
            for shift in [12, 8, 4, 0] {
                out.push(b"0123456789ABCDEF"[usize::from(crc >> shift & 15)]);
            }
            out.push(b'\r');
        };
        match request {
            _ if request.starts_with(b"APIREV") => text(b"D.001.007"),
            _ if request.starts_with(b"PHSR:04") => text(b"0101031"),
            _ if request.starts_with(b"PHSR") => text(b"00"),
            _ if !request.starts_with(b"BX:") => text(b"OKAY"),
            _ => {
                let at = |index: u32| (number * 3 + index * 200) as f32;
                let mut block = [0; 1 + 42 + 1 + 32 + 255 * 12 + 2];
                block[..3].copy_from_slice(&[1, 1, 1]);
                block[39..43].copy_from_slice(&number.to_le_bytes());
                block[43] = 255;
                for index in 0..255 {
                    let place = 76 + 12 * index as usize;
                    block[place..place + 4].copy_from_slice(&at(index).to_le_bytes());
                }
                out.extend([0xC4, 0xA5]);
                out.extend((block.len() as u16).to_le_bytes());
                out.extend(crc16(out).to_le_bytes());
                out.extend(block);
                out.extend(crc16(&block).to_le_bytes());
            }
        }
    }

    /// One read: executes the line commands and delivers the reply. Returns the number of markers received.
    fn ndi_read(
        host: &mut NdiHost,
        commands: &LineCommandReceiver,
        now_ns: &mut u64,
        wire: &mut Vec<u8>,
    ) -> usize {
        wire.clear();
        while let Some(command) = commands.try_recv() {
            if let LineCommand::Write { request, not_before_ns } = command {
                *now_ns = not_before_ns.max(*now_ns) + 1_000_000;
                ndi_reply(request.as_bytes(), (*now_ns / 16_000_000) as u32, wire);
            }
        }
        commands.set_now_ns(*now_ns);
        let mut n_markers = 0;
        for piece in wire.chunks(1000) {
            host.push(piece, &mut |event| {
                if let DeviceEvent::Frame(frame) = event {
                    n_markers += frame.markers.len();
                }
                black_box(event);
            });
        }
        n_markers
    }

    #[test]
    fn an_ndi_host_polls_without_allocating() {
        let (sender, commands) = line_command_channel();
        let mut host = NdiHost::new(sender, 9_600_000);
        let (mut now_ns, mut wire) = (0, Vec::with_capacity(8192));
        host.command(Command::Identify, &mut Vec::new());
        host.command(Command::Start { line_bytes_per_s: 0 }, &mut Vec::new());
        let mut n_markers = 0;
        for _ in 0..200 {
            n_markers += ndi_read(&mut host, &commands, &mut now_ns, &mut wire);
        }
        assert!(n_markers > 50 * 256, "{n_markers}");
        let before = ALLOCATIONS.get();
        let mut n_markers = 0;
        for _ in 0..1_000 {
            n_markers += ndi_read(&mut host, &commands, &mut now_ns, &mut wire);
        }
        assert!(n_markers > 500 * 256, "{n_markers}");
        assert_eq!(ALLOCATIONS.get(), before);
    }

    /// Delivers what a server sends, and executes what the driver sends. Returns the number of markers received.
    fn qtm_read(
        host: &mut QtmHost,
        commands: &LineCommandReceiver,
        server: &mut QtmServer,
        client: ClientId,
    ) -> usize {
        while let Some(command) = commands.try_recv() {
            if let LineCommand::Write { request, .. } = command {
                server.receive(client, request.as_bytes());
            }
        }
        let mut n_markers = 0;
        let pending = server.pending(client);
        let n = pending.len();
        for piece in pending.chunks(1000) {
            host.push(piece, &mut |event| {
                if let DeviceEvent::Frame(frame) = event {
                    n_markers += frame.markers.len();
                }
                black_box(event);
            });
        }
        server.sent(client, n);
        n_markers
    }

    #[test]
    fn a_qtm_host_decodes_without_allocating() {
        let (sender, commands) = line_command_channel();
        let uri: DeviceUri = "qtm:lab".parse().unwrap();
        let mut host = QtmHost::new(&uri.location, sender, None);
        let labels = (0..100).map(|k| format!("m{k}")).collect();
        let settings = ServedSettings {
            frequency_hz: 1000.0,
            up_axis: "+Z",
            labels,
            bodies: vec![BodySettings::default(); 12],
            ..ServedSettings::default()
        };
        let mut server = QtmServer::new(settings, "1".to_owned());
        let client = server.connect(([127, 0, 0, 1], 1).into()).unwrap();
        host.command(Command::Identify, &mut Vec::new());
        host.command(Command::Start { line_bytes_per_s: 0 }, &mut Vec::new());
        for _ in 0..20 {
            qtm_read(&mut host, &commands, &mut server, client);
        }
        let bodies = [ServedBody { position_mm: [1.0; 3], ..ServedBody::LOST }; 12];
        // Unlabelled markers come and go.
        let marker = |id| WireMarker { position_mm: [1.0; 3], id, residual_mm: 0.1 };
        let markers: Vec<WireMarker> = (0..100).map(marker).collect();
        let mut allocated = 0;
        for number in 0..1_100_u32 {
            server.frame(&ServedFrame {
                header: FrameHeader { time_us: u64::from(number) * 1000, number },
                rates: [1, 0],
                labelled: &markers,
                unlabelled: &markers[(number % 40) as usize..60],
                bodies: &bodies,
                lacks_bodies: false,
            });
            let before = ALLOCATIONS.get();
            let n_markers = qtm_read(&mut host, &commands, &mut server, client);
            if number >= 100 {
                allocated += ALLOCATIONS.get() - before;
            }
            assert_eq!(n_markers, 160 - (number % 40) as usize);
        }
        assert_eq!(allocated, 0);
    }
}
