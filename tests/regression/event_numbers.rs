//! The frame of an event has the same number in `info`, in the imported file and in exports.

use mocapd_take::interchange::Format;

use crate::{
    cli::Folder,
    support::{assert_mentions, jump},
};

#[test]
fn info_and_files_number_the_frame_of_an_event_alike() {
    let folder = Folder::new();
    let mut motion = jump(1, 100.0, 1.0);
    motion.info.source.first_frame = 695;
    let mut tsv = Vec::new();
    let event = mocapd_take::motion::MotionEvent {
        frame: 40,
        kind: mocapd_take::record::EventKind::Mark,
        text: "toe off".to_owned(),
    };
    motion.info.events.push(event);
    Format::Tsv.write(&mut mocapd_take::motion::MotionFrames::new(&motion), &mut tsv).unwrap();
    assert!(String::from_utf8_lossy(&tsv).contains("EVENT\ttoe off\t735\t0.4"));
    folder.write("a.tsv", tsv);
    folder.run(&["import", "a.tsv", "-o", "a.take"]).with_code(0);
    let printed = folder.run(&["info", "a.take"]).with_code(0).stdout;
    let line = printed.lines().find(|line| line.contains("toe off")).unwrap();
    assert_mentions(line, &["frame 735", "0.400 s", "mark"]);
    folder.run(&["export", "a.take", "-o", "b.tsv"]).with_code(0);
    assert!(folder.text("b.tsv").contains("EVENT\ttoe off\t735\t0.4"));
}
