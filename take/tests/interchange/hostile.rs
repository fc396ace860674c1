//! Truncated and damaged files give an error or a motion, never a panic, and never more memory than their size
//! justifies.

use std::io::Cursor;

use mocapd_take::interchange::{Format, npz};
use mocapd_take::motion::{Marker, Motion, MotionFrames, MotionInfo, Source};

use crate::c3d_file::{C3dFile, Order};

/// Maximum number of bytes of positions per byte of input.
const EARNED: usize = 48;

/// Reads bytes and, if they give a motion, writes it again, because foreign parts are hostile, too.
fn survive(format: Format, bytes: &[u8]) {
    let Ok(motion) = format.read(bytes) else { return };
    let positions = size_of_val(&motion.positions_mm[..]);
    assert!(
        positions <= bytes.len() * EARNED,
        "{positions} bytes of positions from {} bytes",
        bytes.len()
    );
    let foreign: u64 = motion.info.foreign.iter().map(|f| f.data.len()).sum();
    assert!(
        foreign <= 2 * bytes.len() as u64 + 1024,
        "{foreign} bytes kept from {} bytes",
        bytes.len()
    );
    assert!(motion.info.markers.is_empty() || motion.n_frames() as u64 == motion.info.n_frames);
    // A refusal is fine: labels may have become too long.
    drop(npz::write(&mut MotionFrames::new(&motion), &mut Cursor::new(Vec::new())));
    drop(Format::Xdf.write(&mut MotionFrames::new(&motion), &mut std::io::sink()));
    drop(format.write(&mut MotionFrames::new(&motion), &mut Vec::new()));
}

fn sweep(format: Format, bytes: &[u8]) {
    assert!(format.read(bytes).is_ok());
    for end in 0..bytes.len() {
        survive(format, &bytes[..end]);
    }
    let mut damaged = bytes.to_vec();
    for index in 0..bytes.len() {
        for value in [bytes[index] ^ 1, bytes[index] ^ 0x80, 0, 0xFF, b'\t', b'9'] {
            damaged[index] = value;
            survive(format, &damaged);
        }
        damaged[index] = bytes[index];
    }
}

fn c3d(order: Order, scale: f32) -> Vec<u8> {
    let frame = vec![1.0, 2.0, 3.0, 0.0, 9.0, 8.0, 7.0, 5.0, 11.0, 12.0];
    let mut file = C3dFile { order, scale, analog: (2, 1), ..C3dFile::new(2, vec![frame; 6]) };
    file.texts(1, "LABELS", &["A", "B"]);
    file.texts(1, "ANGLES", &["B"]);
    file.texts(1, "TYPE_GROUPS", &["ANGLES", "ANGLE"]);
    file.records.extend(file.group(2, "TRIAL"));
    file.words(2, "ACTUAL_START_FIELD", &[1, 0]);
    file.words(2, "ACTUAL_END_FIELD", &[6, 0]);
    file.records.extend(file.group(3, "EVENT"));
    file.words(3, "USED", &[2]);
    file.texts(3, "CONTEXTS", &["Left", "General"]);
    file.texts(3, "LABELS", &["On", "Off"]);
    let times = [0.0, 0.0, 0.0, 0.02];
    let times: Vec<u8> = times.iter().flat_map(|&t| order.float(t)).collect();
    file.records.extend(file.record(3, "TIMES", 4, &[2, 2], &times));
    file.bytes()
}

#[test]
fn c3d_files_of_every_kind() {
    sweep(Format::C3d, &c3d(Order::Intel, -1.0));
    sweep(Format::C3d, &c3d(Order::Dec, 0.5));
    sweep(Format::C3d, &c3d(Order::Mips, -1.0));
}

#[test]
fn text_files_of_every_kind() {
    let info = MotionInfo {
        rate_hz: 50.0,
        n_frames: 4,
        markers: ["A", "b,c"].map(|l| Marker { label: l.to_owned(), labelled: true }).to_vec(),
        source: Source { factor: 1.0, first_frame: 1, ..Source::default() },
        ..MotionInfo::default()
    };
    let motion = Motion { info, positions_mm: vec![[1.5, -2.25, 1e6]; 8] };
    for format in [Format::Trc, Format::Csv, Format::CsvLong, Format::Tsv] {
        let mut bytes = Vec::new();
        format.write(&mut MotionFrames::new(&motion), &mut bytes).expect("memory");
        sweep(format, &bytes);
    }
    let tsv = "NO_OF_FRAMES\t2\nFREQUENCY\t60\nEVENT\te\t2\t0.01\nMARKER_NAMES\tA\tB\nFrame\tA X\tA Y\tA Z\n1\t1\t2\t3\n2\t1\t2\t3\t4\t5\t6\n";
    sweep(Format::Tsv, tsv.as_bytes());
    let motive = "Format Version,1.23,Export Frame Rate,120,Length Units,Meters\n\n,,Marker,Marker,Marker\n,,A,A,A\n,,1,1,1\n\
                  ,,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z\n0,0.0,1.5,2.5,3.5\n1,0.008333,1.5,2.5,3.5\n";
    sweep(Format::Csv, motive.as_bytes());
}

#[test]
fn huge_counts_allocate_no_memory() {
    let mut trc = b"PathFileType\nDataRate\tNumFrames\tNumMarkers\tUnits\n100\t4000000000\t4000000000\tmm\nFrame#\tTime\n\n".to_vec();
    trc.extend(b"1\t0\n".repeat(2000));
    trc.extend(b"2\t0");
    trc.extend(b"\t1".repeat(30_000));
    assert!(Format::Trc.read(&trc).is_err());
    let mut long = b"frame,time_s,label,x_mm,y_mm,z_mm\n0,0,a,1,2,3\n".to_vec();
    long.extend(b"9000000000000000,1,a,1,2,3\n");
    assert!(Format::Csv.read(&long).is_err());
    // Lists of texts without length take no bytes, but even thousands of them stay bounded.
    let mut file = C3dFile::new(1, vec![vec![0.0; 4]]);
    for number in 2..200 {
        file.records.extend(file.record(
            1,
            &format!("LABELS{number}"),
            -1,
            &[0, 255, 255, 255],
            &[],
        ));
    }
    file.records.extend(file.record(1, "LABELS", -1, &[0, 255, 255, 255], &[]));
    assert_eq!(Format::C3d.read(&file.bytes()).expect("a usable file").info.markers.len(), 1);
}
