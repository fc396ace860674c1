//! The figures as Markdown for the documentation and as CSV.

use mocapd_codec::ResamplerKind;
use mocapd_take::motion::Motion;

use crate::{
    RATES_HZ, RESAMPLERS, TOLERANCES_MM,
    coding::EncodedSize,
    noise::{BANDS, Noise},
    smooth::Smooth,
};

/// One version of the motion, encoded with one resampler at one tolerance.
#[derive(Debug)]
pub(crate) struct Point {
    pub(crate) kind: ResamplerKind,
    pub(crate) tolerance_mm: f64,
    pub(crate) rate_hz: f64,
    pub(crate) is_noisy: bool,
    pub(crate) size: EncodedSize,
}

/// All versions of one take.
#[derive(Debug)]
pub(crate) struct Study {
    pub(crate) name: String,
    pub(crate) n_markers: usize,
    markers_in_take: usize,
    recorded_hz: f64,
    seconds: f64,
    noise: Noise,
    points: Vec<Point>,
}

impl Study {
    pub(crate) fn new(
        name: String,
        motion: &Motion,
        smooth: &Smooth,
        noise: Noise,
        points: Vec<Point>,
    ) -> Self {
        let (markers_in_take, seconds) = (motion.info.markers.len(), smooth.seconds());
        let (n_markers, recorded_hz) = (smooth.n_markers, smooth.rate_hz);
        Self { name, n_markers, markers_in_take, recorded_hz, seconds, noise, points }
    }

    /// Rate of the raw samples in bytes per second, three float32 each.
    pub(crate) fn raw_bytes_per_s(&self, rate_hz: f64) -> f64 {
        12.0 * self.n_markers as f64 * rate_hz
    }

    /// Pairs of rate in Hz and bytes per second, in ascending order of the rate.
    pub(crate) fn line(
        &self,
        kind: ResamplerKind,
        tolerance_mm: f64,
        is_noisy: bool,
    ) -> Vec<(f64, f64)> {
        let of_line =
            |p: &&Point| p.kind == kind && p.tolerance_mm == tolerance_mm && p.is_noisy == is_noisy;
        let points = self.points.iter().filter(of_line);
        points.map(|p| (p.rate_hz, p.size.bytes_per_s())).collect()
    }

    /// The median standard deviation of the noise over all markers and axes, in millimetres.
    pub(crate) fn sigma_mm(&self) -> f64 {
        median(&mut self.noise.sigma_mm.iter().flatten().copied().collect::<Vec<_>>())
    }
}

/// The upper median; 0 without values.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The exponent e of bytes ~ rate^e between the ends of a line: 1 for raw samples, 0 when a higher rate costs nothing.
fn exponent(line: &[(f64, f64)]) -> f64 {
    let (Some(first), Some(last)) = (line.first(), line.last()) else { return f64::NAN };
    (last.1 / first.1).ln() / (last.0 / first.0).ln()
}

pub(crate) fn markdown(study: &Study) -> String {
    let mut text = about(study);
    let rates: Vec<String> = RATES_HZ.iter().map(|hz| format!("{hz} Hz")).collect();
    let head = format!(
        "\n| bytes a second | {} | growth | exponent | without noise |\n",
        rates.join(" | ")
    );
    text += &head;
    text += &format!("|{}\n", "---|".repeat(RATES_HZ.len() + 4));
    let mut row = |name: String, line: &[(f64, f64)], without: &str| {
        let cells: Vec<String> = line.iter().map(|(_, bytes)| format!("{bytes:.0}")).collect();
        let growth = line.last().map_or(0.0, |l| l.1) / line.first().map_or(1.0, |f| f.1);
        let cells = cells.join(" | ");
        text +=
            &format!("| {name} | {cells} | {growth:.2} | {:.2} | {without} |\n", exponent(line));
    };
    let raw: Vec<_> = RATES_HZ.iter().map(|&hz| (hz, study.raw_bytes_per_s(hz))).collect();
    row("float32".to_owned(), &raw, "1.00");
    for kind in RESAMPLERS {
        for tolerance_mm in TOLERANCES_MM {
            let without = exponent(&study.line(kind, tolerance_mm, false));
            let name = format!("**{kind}**, {tolerance_mm} mm");
            row(name, &study.line(kind, tolerance_mm, true), &format!("{without:.2}"));
        }
    }
    text
}

fn about(study: &Study) -> String {
    let Study { name, n_markers, markers_in_take, recorded_hz, seconds, noise, .. } = study;
    let all = noise.sigma_mm.iter().flatten();
    let (low, high) = all.fold((f64::MAX, 0.0_f64), |(low, high), &mm| (low.min(mm), high.max(mm)));
    let [x, y, z] = median_axes(&noise.sigma_mm);
    let last = &noise.bands[BANDS - 1];
    let (from_hz, to_hz) = (last.from_hz, last.to_hz);
    let [mean_x, mean_y, mean_z] = median_axes(&last.mean).map(|d| d * (recorded_hz / 2.0).sqrt());
    let densities = noise.bands.iter().map(|band| {
        let density = median(&mut band.typical.iter().flatten().copied().collect::<Vec<_>>());
        format!("{density:.4} at {:.0} to {:.0} Hz", band.from_hz, band.to_hz)
    });
    let densities = densities.collect::<Vec<_>>().join(", ");
    format!(
        "**{name}**: {n_markers} of {markers_in_take} markers (those without gaps), {seconds:.1} s, \
         recorded at {recorded_hz} Hz.\n\
         Noise on x, y and z: {x:.3}, {y:.3} and {z:.3} mm (standard deviation of the median marker; \
         all markers and axes {low:.3} to {high:.3} mm), from {from_hz:.0} to {to_hz:.0} Hz in the \
         median half second; with impacts and glitches it would be {mean_x:.3}, {mean_y:.3} and \
         {mean_z:.3} mm.\n\
         Its density, in mm per root of a Hz: {densities}.\n"
    )
}

/// The median over all markers, for each axis.
fn median_axes(by_marker: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        median(&mut by_marker.iter().map(|axes| axes[axis]).collect::<Vec<_>>())
    })
}

pub(crate) fn csv(studies: &[Study]) -> String {
    let mut text = "take,markers,rate_hz,noise,resampler,tolerance_mm,seconds,bytes,bytes_per_s,\
                    raw_bytes_per_s,max_error_mm\n"
        .to_owned();
    for study in studies {
        for Point { kind, tolerance_mm, rate_hz, is_noisy, size } in &study.points {
            let raw = study.raw_bytes_per_s(*rate_hz);
            let n_markers = study.n_markers;
            let EncodedSize { bytes, seconds, max_error_mm } = size;
            let (name, noise, bytes_per_s) = (&study.name, u8::from(*is_noisy), size.bytes_per_s());
            text += &format!(
                "{name},{n_markers},{rate_hz},{noise},{kind},{tolerance_mm},{seconds:.4},{bytes},\
                 {bytes_per_s:.1},{raw:.0},{max_error_mm:.6}\n"
            );
        }
    }
    text
}
