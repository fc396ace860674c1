use super::*;

fn written() -> (Vec<u8>, Vec<Record<'static>>) {
    let entries = [
        Entry::Opened("dvmc a line"),
        Entry::ToDevice(&[0, 1, 2]),
        Entry::FromDevice(&[]),
        Entry::Break,
        Entry::Baud(921_600),
        Entry::FromDevice(&[9; 300]),
        Entry::Missing(77),
        Entry::Closed,
        Entry::End,
    ];
    let mut log = Vec::new();
    put_head(&mut log);
    let records = (0..).zip(entries).map(|(i, entry)| Record { time_ns: i << 40, entry });
    let records: Vec<_> = records.collect();
    records.iter().for_each(|record| put_record(record, &mut log));
    (log, records)
}

#[test]
fn records_come_back_as_they_were() {
    let (log, expected) = written();
    let found: Result<Vec<_>, _> = records(&log).unwrap().collect();
    assert_eq!(found.unwrap(), expected);
    assert_eq!(log.len(), HEAD_BYTES + 9 * RECORD_OVERHEAD_BYTES + 11 + 3 + 4 + 300 + 8);
}

#[test]
fn a_long_payload_goes_as_several_records() {
    let bytes = vec![5; 2 * PAYLOAD_BYTES_MAX + 1];
    let mut log = Vec::new();
    put_head(&mut log);
    put_record(&Record { time_ns: 3, entry: Entry::FromDevice(&bytes) }, &mut log);
    let lengths: Vec<usize> = records(&log)
        .unwrap()
        .filter_map(|record| match record {
            Ok(Record { time_ns: 3, entry: Entry::FromDevice(bytes) }) => Some(bytes.len()),
            _ => None,
        })
        .collect();
    assert_eq!(lengths, [PAYLOAD_BYTES_MAX, PAYLOAD_BYTES_MAX, 1]);
}

#[test]
fn every_cut_and_every_changed_byte_is_found() {
    let (log, expected) = written();
    for end in 0..log.len() {
        let found: Vec<_> = match records(&log[..end]) {
            Ok(records) => records.collect(),
            Err(error) => vec![Err(error)],
        };
        let (last, good) = found.split_last().unwrap();
        assert!(matches!(last, Err(RawLogError::CutOff { .. } | RawLogError::NotALog)), "{end}");
        assert!(good.iter().zip(&expected).all(|(found, wanted)| found.as_ref() == Ok(wanted)));
    }
    for at in 0..log.len() {
        let mut log = log.clone();
        log[at] ^= 0x10;
        let found: Result<Vec<_>, _> = records(&log).and_then(Iterator::collect);
        assert!(found.is_err(), "byte {at}");
    }
}

#[test]
fn other_files_and_later_versions_are_refused() {
    assert_eq!(records(b"").unwrap_err(), RawLogError::NotALog);
    assert_eq!(records(b"seq,ticks\n1,2\n").unwrap_err(), RawLogError::NotALog);
    let (mut log, _) = written();
    log[MAGIC.len()] = 9;
    assert_eq!(records(&log).unwrap_err(), RawLogError::Version { found: 9 });
}
