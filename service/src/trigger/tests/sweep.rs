//! Damaged datagrams: none ends the process, and every parsed result is bounded and never a path.

use super::*;

/// Reproducible pseudo-random numbers.
struct Noise(u64);

impl Noise {
    fn below(&mut self, end: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % end.max(1)
    }
}

const PIECES: &[&str] = &[
    "<",
    ">",
    "/",
    "\"",
    "'",
    "&",
    ";",
    "=",
    "&amp;",
    "&#0;",
    "&#x1;",
    "&#x110000;",
    "&lt;",
    "<!--",
    "-->",
    "<![CDATA[",
    "]]>",
    "<?",
    "?>",
    "<!DOCTYPE x>",
    "../",
    "\\",
    "\0",
    "\u{202e}",
    "\u{feff}",
    ".take",
    "-",
    " ",
    "9999999999999999999",
    "VALUE",
    "xmlns='x'",
    "CaptureStop",
    "Complete",
    "<Name VALUE=\"b\"/>",
    "encoding=\"UTF-16\"",
    "é",
    "nan",
];

fn seeds() -> Vec<Vec<u8>> {
    let mut announcer = Announcer::new("left", 7, 1);
    let name = TakeName::of("walk & run").unwrap();
    vec![
        start("<Name VALUE=\"walk_03\"/><Notes VALUE=\"x\"/><DatabasePath VALUE=\"/data\"/><Delay VALUE=\"33\"/>\
               <PacketID VALUE=\"33360\"/>").into_bytes(),
        b"<CaptureStop RESULT=\"SUCCESS\"><Name VALUE='walk_03'/><Delay VALUE='0'/></CaptureStop>\0".to_vec(),
        announcer.start(&name, "barefoot"),
        announcer.stop(&name, &StopResult::Fail),
    ]
}

fn check(datagram: &[u8]) -> bool {
    match parse(datagram) {
        Ok(trigger) => {
            if let Some(name) = trigger.capture().name.as_ref() {
                let name = name.text();
                assert!(!name.is_empty() && name.len() <= crate::config::NAME_BYTES_MAX, "{name}");
                assert!(
                    !name.contains(['/', '\\', '\0']) && !name.starts_with(['.', '-']),
                    "{name}"
                );
                assert!(!name.contains(char::is_control), "{name:?}");
                // Normalising a name again changes nothing.
                let again = TakeName::of(name).unwrap();
                assert_eq!((again.text(), again.was_changed()), (name, false));
            }
            let note = trigger.note(FROM);
            assert!(!note.contains(char::is_control), "{note:?}");
            assert!(note.len() < 32 << 10, "{}", note.len());
            true
        }
        Err(refusal) => {
            let message = refusal.to_string();
            assert!(message.len() < 500 && !message.contains(char::is_control), "{message:?}");
            false
        }
    }
}

#[test]
fn every_cut_and_every_changed_byte() {
    for seed in seeds() {
        assert!(check(&seed));
        for end in 0..seed.len() {
            check(&seed[..end]);
            for byte in [0, b' ', b'<', b'"', b'&', b'/', 0x80, 0xff, seed[end] ^ 1] {
                let mut changed = seed.clone();
                changed[end] = byte;
                check(&changed);
            }
        }
    }
}

#[test]
fn ten_thousand_damaged_datagrams() {
    let (seeds, mut noise, mut n_understood) = (seeds(), Noise(1), 0);
    for round in 0..10_000 {
        let mut bytes = seeds[round % seeds.len()].clone();
        for _ in 0..=noise.below(3) {
            let at = noise.below(bytes.len() + 1);
            let end = (at + noise.below(8)).min(bytes.len());
            let piece = match noise.below(3) {
                0 => Vec::new(),
                1 => PIECES[noise.below(PIECES.len())].as_bytes().to_vec(),
                _ => {
                    let from = noise.below(bytes.len());
                    bytes[from..(from + noise.below(60)).min(bytes.len())].to_vec()
                }
            };
            bytes.splice(at..if noise.below(2) == 0 { at } else { end }, piece);
        }
        n_understood += usize::from(check(&bytes));
    }
    assert!((500..9_500).contains(&n_understood), "{n_understood} understood");
}
