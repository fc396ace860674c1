//! The golden takes as this build writes them: recordings with the live resamplers, imports with the others.

use mocapd_codec::{BlockEncoder, BlockReport, ResamplerKind, Rows, Settings, Tolerance};
use mocapd_take::{
    ChannelOrder, TakeWriter,
    record::{CODEC_VERSION, Channel, Header, ImportSource, LONG_KEYS_VERSION, Ledger},
    statistics::{BlockTally, StretchTally},
    stretch::{Span, StretchHeaderWriter, put_block},
    timeline::Timeline,
};

use super::{
    motion::{Column, MARKERS, markers},
    recording::blank,
    sampled,
    times::{PLANS, RATE_HZ, STRETCH_ROWS, n_rows, timelines},
};

/// A golden take.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Golden {
    pub(crate) name: &'static str,
    resampler: &'static str,
    pub(crate) tolerance_mm: f64,
    /// Number of markers of the seeded motion.
    pub(crate) n_markers: usize,
    /// Whether it has foreign parts with samples.
    has_samples: bool,
    /// Its markers are coded in another order than that of the source.
    is_ordered: bool,
}

/// A take and its original content.
#[derive(Debug)]
pub(crate) struct Written {
    pub(crate) bytes: Vec<u8>,
    /// By channel.
    pub(crate) columns: Vec<(usize, Column)>,
    pub(crate) timelines: Vec<Timeline>,
}

/// All golden takes, with as many markers as keep them small in total.
pub(crate) const GOLDENS: [Golden; 13] = [
    Golden {
        name: "dense-0.1mm",
        resampler: "dense",
        tolerance_mm: 0.1,
        n_markers: 12,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "dense-1mm",
        resampler: "dense",
        tolerance_mm: 1.0,
        n_markers: 16,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "dense-20mm",
        resampler: "dense",
        tolerance_mm: 20.0,
        n_markers: MARKERS,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "dense-order",
        resampler: "dense",
        tolerance_mm: 1.0,
        n_markers: 9,
        has_samples: false,
        is_ordered: true,
    },
    Golden {
        name: "fast-1mm",
        resampler: "fast",
        tolerance_mm: 1.0,
        n_markers: 14,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "lossless",
        resampler: "lossless",
        tolerance_mm: 0.0,
        n_markers: 7,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "lossless-predictive",
        resampler: "lossless:predictive",
        tolerance_mm: 0.0,
        n_markers: 7,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "spline-1mm",
        resampler: "spline:worst-sample",
        tolerance_mm: 1.0,
        n_markers: 8,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "sync-20mm",
        resampler: "sync:worst-sample",
        tolerance_mm: 20.0,
        n_markers: 7,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "sampled",
        resampler: "spline:worst-sample",
        tolerance_mm: 20.0,
        n_markers: 3,
        has_samples: true,
        is_ordered: false,
    },
    Golden {
        name: "sampled-bounded",
        resampler: "sync:worst-sample",
        tolerance_mm: 20.0,
        n_markers: 2,
        has_samples: true,
        is_ordered: false,
    },
    Golden {
        name: "poses-0.5mm",
        resampler: "dense",
        tolerance_mm: 0.5,
        n_markers: 4,
        has_samples: false,
        is_ordered: false,
    },
    Golden {
        name: "poses-lossless",
        resampler: "lossless",
        tolerance_mm: 0.0,
        n_markers: 3,
        has_samples: false,
        is_ordered: false,
    },
];

/// An import whose first stretch is its only key, of the version for that.
pub(crate) const LONG_KEYS: Golden = Golden {
    name: "long-keys-1mm",
    resampler: "dense",
    tolerance_mm: 1.0,
    n_markers: 9,
    has_samples: false,
    is_ordered: false,
};

/// The golden takes of both versions.
pub(crate) fn all() -> impl Iterator<Item = Golden> {
    GOLDENS.into_iter().chain([LONG_KEYS])
}

impl Golden {
    /// The version of the take.
    pub(crate) fn version(&self) -> u16 {
        if self.name == LONG_KEYS.name { LONG_KEYS_VERSION } else { CODEC_VERSION }
    }

    pub(crate) fn file(&self) -> String {
        // Not .take: git ignores that extension, because recordings never belong here.
        format!("{}.mtake", self.name)
    }

    /// Whether it has poses of rigid bodies, and force plates.
    pub(crate) fn has_poses(&self) -> bool {
        self.name.starts_with("poses")
    }

    pub(crate) fn settings(&self) -> Settings {
        let kind: ResamplerKind = self.resampler.parse().unwrap();
        let mm = if kind.is_lossless() { Tolerance::MAX_MM } else { self.tolerance_mm };
        Settings { kind, tolerance: Tolerance::from_mm(mm).unwrap() }
    }

    /// Writes the take; the bytes are the same on every machine, at any time.
    pub(crate) fn write(&self) -> Written {
        let is_recording =
            self.settings().kind.is_live() && self.version() == CODEC_VERSION && !self.is_ordered;
        if is_recording { self.record() } else { self.import() }
    }

    pub(crate) fn header(&self) -> Header {
        let mut header = Header {
            software: "mocapd, golden take".to_owned(),
            take_id: *b"a golden take id",
            created_unix_ms: 0,
            resampler: String::new(),
            codec_version: CODEC_VERSION,
            tolerance_mm: 0.0,
            rate_hz: RATE_HZ as f64,
            up_axis: mocapd_take::motion::UpAxis::Z,
            device: None,
            source: None,
            channels: (0..self.n_markers).map(channel).collect(),
            stretch_rows: STRETCH_ROWS,
            settings: Vec::new(),
        };
        header.set_codec(&self.settings());
        header
    }

    /// The order of the markers.
    fn order(&self) -> ChannelOrder {
        let column =
            |row: usize| if self.is_ordered { (5 * row + 3) % self.n_markers } else { row };
        let columns = (0..self.n_markers).map(|row| column(row) as u16);
        ChannelOrder::from_columns(columns.collect()).unwrap()
    }

    /// Like an import: key stretches without time lines.
    fn import(&self) -> Written {
        let source = ImportSource {
            format: "generated".to_owned(),
            file: "seeded motion".to_owned(),
            unit: "m".to_owned(),
            factor: 1000.0,
            first_frame: 7,
            warnings: vec!["it was never recorded".to_owned()],
        };
        let drops_foreign = ("drop_foreign".to_owned(), "true".to_owned());
        let settings = if self.has_samples { Vec::new() } else { vec![drops_foreign] };
        let mut header = Header { source: Some(source), settings, ..self.header() };
        if self.version() == LONG_KEYS_VERSION {
            header.codec_version = LONG_KEYS_VERSION;
            header.settings.push(("keys".to_owned(), "none".to_owned()));
        }
        let order = self.order();
        order.apply_to_table(&mut header.channels);
        let mut columns = markers(n_rows());
        columns.truncate(self.n_markers);
        blank(&mut columns, self.n_markers, &timelines());
        // Without the short first stretch, so that the empty stretch has full length here, too.
        let short = PLANS[0].n_rows as usize;
        columns.iter_mut().for_each(|column| column.drop_front(short));
        let n_rows = n_rows() - short;

        let settings = self.settings();
        let mut encoder = settings.encoder();
        let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
        take.order(&order).unwrap();
        if self.has_samples {
            let mut parts = sampled::parts();
            if self.name == "sampled-bounded" {
                sampled::bound(&mut parts);
            }
            parts.iter().for_each(|part| take.foreign(part).unwrap());
        }
        let mut front = StretchHeaderWriter::new(STRETCH_ROWS);
        let mut ledger = Ledger { finished: true, ..Ledger::default() };
        for (number, first) in (0..n_rows).step_by(STRETCH_ROWS as usize).enumerate() {
            let end = n_rows.min(first + STRETCH_ROWS as usize);
            let span = Span {
                first_row: first as u64,
                n_rows: (end - first) as u32,
                key: number == 0 || self.version() == CODEC_VERSION,
                number: number as u8,
            };
            let mut rows: Vec<_> = columns.iter().map(|column| column.part(first..end)).collect();
            order.apply(&mut rows);
            let shared = settings.plan(&rows).unwrap();
            let (block, tally, n) = encode(encoder.as_mut(), &rows, &shared, span.key);
            let mut payload = Vec::new();
            front.put(span, &Timeline::default(), &shared, true, &mut payload);
            put_block(&block, true, &mut payload);
            take.stretch(span, &payload, &StretchTally::of(&tally)).unwrap();
            ledger.samples_present += n;
        }
        (ledger.frames_sent, ledger.recorded) = (n_rows as u64, n_rows as u64);
        ledger.samples_announced = ledger.recorded * self.n_markers as u64;
        ledger.samples_occluded = ledger.samples_announced - ledger.samples_present;
        let (bytes, _) = take.finish(&ledger).unwrap();
        Written { bytes, columns: columns.into_iter().enumerate().collect(), timelines: Vec::new() }
    }
}

/// An entry of the channel table. The marker that jumps is unlabelled, and so are entries beyond the markers.
pub(crate) fn channel(column: usize) -> Channel {
    let labelled = column < MARKERS && column != 2;
    let label =
        if labelled { format!("Golden:m{column:02}") } else { format!("u{:03}", column + 1) };
    // A device's ids differ from the columns.
    let marker_id = (column + if column < 4 { 0 } else { 1_000 }) as u16;
    Channel { marker_id, label, labelled }
}

/// The block, what it holds, and its number of samples.
pub(crate) fn encode(
    encoder: &mut dyn BlockEncoder,
    rows: &[Rows<'_>],
    shared: &[u8],
    key: bool,
) -> (Vec<u8>, BlockTally, u64) {
    let mut block = Vec::new();
    let mut reports = vec![BlockReport::default(); rows.len()];
    encoder.encode(rows, shared, key, &mut block, &mut reports).unwrap();
    let tally = BlockTally::of_encoded(&block, rows, &reports, encoder.kept_rows());
    (block, tally, reports.iter().map(|report| u64::from(report.samples)).sum())
}
