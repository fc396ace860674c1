//! Ten thousand damaged files: none ends the process, and an accepted one is the same after it was written out.

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

/// Pieces to insert into files.
const PIECES: &[&str] = &[
    "\"",
    "'",
    "[",
    "]",
    "{",
    "}",
    "=",
    "#",
    "\n",
    ".",
    ",",
    "-",
    "+",
    "0",
    "9",
    "1e9",
    "nan",
    "inf",
    "true",
    "\\u0000",
    "\\\\",
    "ms",
    "s",
    "min",
    "h",
    "mm",
    "um",
    "GiB",
    "kB",
    "Hz",
    "{count}",
    "{rig}",
    "auto",
    "serial:",
    "usb:",
    "::",
    "/0",
    "/32",
    ":0",
    ":65535",
    "..",
    "/",
    "\u{e9}",
    "\u{feff}",
    "\u{202e}",
    "0x7f",
    "07:32:00",
    "[take]\n",
    "lossless = true\n",
    "pre_roll = \"0.000000001s\"\n",
    "listen = \"\"\n",
    "e-4",
    "E5",
    "_",
];

fn mutated(seed: &[u8], noise: &mut Noise) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=noise.below(2) {
        let at = noise.below(bytes.len() + 1);
        let end = (at + noise.below(6)).min(bytes.len());
        match noise.below(6) {
            0 if at < bytes.len() => bytes[at] ^= 1 << noise.below(8),
            1 if at < bytes.len() => bytes[at] = b"0123456789"[noise.below(10)],
            2 => drop(bytes.drain(at..end)),
            3 => {
                let piece: Vec<u8> = bytes[at..end].to_vec();
                let to = noise.below(bytes.len() + 1);
                bytes.splice(to..to, piece);
            }
            _ => {
                let piece = PIECES[noise.below(PIECES.len())].bytes();
                bytes.splice(at..if noise.below(2) == 0 { at } else { end }, piece);
            }
        }
    }
    bytes
}

#[test]
fn ten_thousand_damaged_files() {
    let numbers = "[device]\nrate_hz = 1\n[take]\ntolerance = \"1mm\"\nstretch = \"1s\"\nkeep_free = \"1B\"\n\
                   [arm]\npre_roll = \"1.5s\"\n[http]\nconnections_max = 9\n";
    let seeds = [
        EVERYTHING.to_owned(),
        numbers.to_owned(),
        parse("").unwrap().to_toml(),
        parse(EVERYTHING).unwrap().to_toml(),
    ];
    let (mut noise, mut n_good, mut n_changed) = (Noise(1), 0, 0);
    for round in 0..10_000 {
        let seed = &seeds[round % seeds.len()];
        let bytes = mutated(seed.as_bytes(), &mut noise);
        let parsed = Config::parse("x", &bytes, &nowhere(), &Overrides::default());
        let text = String::from_utf8_lossy(&bytes);
        match parsed {
            Ok(config) => {
                let written = config.to_toml();
                let again =
                    parse(&written).unwrap_or_else(|e| panic!("{round}: {text}\n{written}\n{e}"));
                assert_eq!(config, again, "{round}: {text}\n{written}");
                n_good += 1;
                n_changed += usize::from(config != parse(seed).unwrap());
            }
            Err(error) => {
                assert!(!error.lines().is_empty(), "{round}: {text}");
                for line in error.lines() {
                    assert!(
                        line.len() < 2000 && !line.contains(char::is_control),
                        "{round}: {line:?}"
                    );
                }
            }
        }
    }
    // Neither all nor none of them are accepted, and some have another meaning than before.
    assert!(
        (300..9_700).contains(&n_good) && n_changed > 200,
        "{n_good} good, {n_changed} changed"
    );
}
