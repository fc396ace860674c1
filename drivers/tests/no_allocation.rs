//! Once the largest frame has been seen, neither end of the link allocates.

#![expect(unsafe_code, reason = "counting allocations takes an allocator")]

#[cfg(test)]
mod no_allocation {
    use std::{
        alloc::{GlobalAlloc, Layout, System},
        cell::Cell,
        hint::black_box,
    };

    use mocapd_drivers::{
        device::{Command, Frame, Hello, MarkerInfo, MarkerSample, Pong, Protocol, Status},
        link::{DeviceLink, FrameForm, HostLink},
    };

    thread_local! {
        /// Of this thread: the test harness allocates on others.
        static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
    }

    struct Counting;

    // SAFETY: every call goes to the system's allocator as it came.
    unsafe impl GlobalAlloc for Counting {
        unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
            ALLOCATIONS.set(ALLOCATIONS.get() + 1);
            // SAFETY: the caller keeps alloc's contract.
            unsafe { System.alloc(layout) }
        }

        unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
            // SAFETY: the pointer came from `alloc` above, with this layout.
            unsafe { System.dealloc(pointer, layout) }
        }

        unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
            ALLOCATIONS.set(ALLOCATIONS.get() + 1);
            // SAFETY: the caller keeps realloc's contract.
            unsafe { System.realloc(pointer, layout, bytes) }
        }
    }

    #[global_allocator]
    static COUNTING: Counting = Counting;

    struct Talk {
        device: DeviceLink,
        host: HostLink,
        wire: Vec<u8>,
        hello: Hello,
        table: Vec<MarkerInfo>,
        markers: Vec<MarkerSample>,
    }

    impl Talk {
        fn round(&mut self, seq: u32) {
            self.wire.clear();
            for form in [FrameForm::Float, FrameForm::Micrometres, FrameForm::Compact] {
                let frame =
                    Frame { seq, device_ticks: 1, timecode: Some([1; 4]), markers: &self.markers };
                self.device.frame(form, &frame, &mut self.wire).unwrap();
            }
            self.device.hello(&self.hello, &mut self.wire).unwrap();
            self.device.markers(&self.table, &mut self.wire).unwrap();
            self.device.status(Status::default(), &mut self.wire);
            self.device.pong(Pong { host_ns: 1, device_ticks: 2 }, &mut self.wire);
            let mut heard = 0;
            for piece in self.wire.chunks(1000) {
                self.host.push(piece, &mut |event| {
                    black_box(event);
                    heard += 1;
                });
            }
            assert!(heard >= 7);
            self.wire.clear();
            self.host.command(Command::Ping { host_ns: 1 }, &mut self.wire);
            let mut asked = 0;
            self.device.push(&self.wire, &mut |_| asked += 1);
            assert_eq!(asked, 1);
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
            rate_mhz: 1,
            rate_max_mhz: 1,
            tick_hz: 1,
            ..Hello::default()
        };
        let mut talk = Talk {
            device: DeviceLink::new(),
            host: HostLink::new(),
            wire: Vec::new(),
            hello,
            table: (0..300).map(info).collect(),
            markers: (0..300).map(marker).collect(),
        };
        talk.round(0);
        let before = ALLOCATIONS.get();
        assert!(before > 0, "the allocator does not count");
        for seq in 1..50 {
            talk.round(seq);
        }
        assert_eq!(ALLOCATIONS.get(), before);
    }
}
