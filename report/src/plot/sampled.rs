//! The sampled channels of an imported C3D file or of a recording against time: analog channels, and the loads of force
//! plates with the trajectory of a marker.

use std::ops::Range;

use mocapd_take::{
    foreign::force_plates::{Baseline, ForcePlate, PlateLoads},
    motion::{Motion, MotionInfo},
};
use plotters::prelude::*;

use super::{
    Area, Axes, BLUE, BODY, DIM, DrawResult, GREEN, INK, ORANGE, PURPLE, SMALL, TITLE, VERMILION,
    centred, left_aligned, panel, range,
    recorded::{self, PlotChannel, Trace, channel_traces, plot_channels},
    sheet, shortened, text,
};
use crate::{
    ReportError,
    column::{Column, runs},
    up::Up,
};

/// Maximum number of panels of analog channels on a sheet.
pub const CHANNELS_MAX: usize = 12;
/// Maximum number of force plates on a sheet, each with two panels.
pub const PLATES_MAX: usize = 4;

pub(super) const WIDTH: u32 = 1280;
pub(super) const HEAD: i32 = 74;
/// Height of a panel, and of the axis of times below the last.
const PANEL: u32 = 128;
pub(super) const TIME_AXIS: u32 = 42;
/// Width of the view from above.
const LEFT: i32 = 480;

/// Colours of plates in the view from above.
const PLATE_COLOURS: [RGBColor; PLATES_MAX] = [BLUE, VERMILION, GREEN, PURPLE];

/// The contents of a plot of analog channels.
#[derive(Debug, Clone, Copy)]
pub struct AnalogPlot<'a> {
    /// The take's name, for the title.
    pub name: &'a str,
    /// The take with its foreign parts.
    pub info: &'a MotionInfo,
    /// Indices of the channels, at most [`CHANNELS_MAX`].
    pub channels: &'a [usize],
    /// The first frame and one past the last, from 0.
    pub rows: (u64, u64),
}

/// The contents of a plot of force plates.
#[derive(Debug, Clone, Copy)]
pub struct ForcesPlot<'a> {
    /// The take's name, for the title.
    pub name: &'a str,
    /// The take with its foreign parts.
    pub info: &'a MotionInfo,
    /// Its samples.
    pub motion: &'a Motion,
    /// Numbers of the plates, at most [`PLATES_MAX`]; empty for the first ones.
    pub plates: &'a [usize],
    /// The column of the marker whose trajectory is drawn, too.
    pub marker: usize,
    /// Indices of channels that are drawn below, at most [`CHANNELS_MAX`].
    pub channels: &'a [usize],
    /// The first frame and one past the last, from 0.
    pub rows: (u64, u64),
    /// The up direction.
    pub up: Up,
}

/// Draws analog channels as SVG.
///
/// # Errors
/// `Nothing` for a take without analog channels, `InvalidArgument` for too many of them.
pub fn analog(plot: &AnalogPlot<'_>) -> Result<String, ReportError> {
    check_channels(plot.channels)?;
    let part = part(plot.info, plot.rows);
    let all = plot_channels(&part)?;
    if all.is_empty() {
        return Err(no_samples("sampled channels"));
    }
    let traces = channel_traces(&part, start_s(&part, plot.rows), plot.channels)?;
    let height = HEAD as u32 + PANEL * traces.len() as u32 + TIME_AXIS;
    sheet((WIDTH, height), |area| {
        let title = format!("Analog channels of {}", shortened(plot.name, 70));
        text(area, &title, (24, 26), left_aligned(TITLE, INK))?;
        let caption = format!("{} of {} channels, {}", traces.len(), all.len(), rates(&traces));
        text(area, &caption, (24, 52), left_aligned(BODY, DIM))?;
        let (_, body) = area.split_vertically(HEAD);
        let curves: Vec<Trace> = traces.iter().map(|(trace, _)| trace.clone()).collect();
        let panels = Panels::new(&body, (traces.len(), PANEL), span_s(&curves));
        for (i, (trace, &channel)) in curves.iter().zip(plot.channels).enumerate() {
            panels.draw(i, &channel_title(all.get(channel)), &[(trace, BLUE, Dash::Solid)])?;
        }
        Ok(())
    })
}

/// `EMG1 (V)`.
fn channel_title(channel: Option<&PlotChannel>) -> String {
    let Some(PlotChannel { name, unit }) = channel else { return String::new() };
    let unit = Some(unit.trim()).filter(|unit| !unit.is_empty());
    let unit = unit.map_or_else(String::new, |unit| format!(" ({})", shortened(unit, 20)));
    format!("{}{unit}", shortened(name, 60))
}

/// `1000 Hz`, or `500 and 1000 Hz`.
fn rates(traces: &[(Trace, f64)]) -> String {
    let mut all: Vec<f64> = traces.iter().map(|(_, rate_hz)| rounded(*rate_hz)).collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    let all: Vec<String> = all.iter().map(f64::to_string).collect();
    format!("{} Hz", all.join(" and "))
}

fn check_channels(channels: &[usize]) -> Result<(), ReportError> {
    if channels.len() <= CHANNELS_MAX {
        return Ok(());
    }
    Err(ReportError::InvalidArgument(format!(
        "{} channels are too many to plot: give up to {CHANNELS_MAX} with --channels",
        channels.len()
    )))
}

/// The time of the first frame of a part of a take.
pub(super) fn start_s(part: &MotionInfo, rows: (u64, u64)) -> f64 {
    rows.0 as f64 / part.rate_hz
}

/// The loads of a plate against time, and its centre of pressure from above.
struct PlateTraces {
    plate: ForcePlate,
    force_n: [Trace; 3],
    cop_mm: [Trace; 3],
    path: Vec<[f64; 3]>,
}

impl PlateTraces {
    fn new(plate: &ForcePlate, trace: impl Fn() -> Trace) -> Self {
        let [force_n, cop_mm] = [(); 2].map(|()| [(); 3].map(|()| trace()));
        Self { plate: plate.clone(), force_n, cop_mm, path: Vec::new() }
    }
}

/// Maximum number of points of a centre of pressure in the view from above.
const PATH_POINTS: u64 = 4000;

/// Draws the loads of force plates as SVG: force and centre of pressure against time, above the height of a marker; and
/// from above the plates, the centres of pressure and the path of the marker.
///
/// # Errors
/// `Nothing` for a take without force plates, `InvalidArgument` for unknown ones or too many.
pub fn forces(plot: &ForcesPlot<'_>) -> Result<String, ReportError> {
    check_channels(plot.channels)?;
    let part = part(plot.info, plot.rows);
    let (traces, n_plates, rate_hz) = match PlateLoads::open(&part, Baseline::AsStored)? {
        Some(loads) => {
            let (n_plates, rate_hz) = (loads.plates().plates.len(), loads.rate_hz());
            (plate_traces(plot, &part, loads)?, n_plates, rate_hz)
        }
        None => recorded_plate_traces(plot, &part)?,
    };
    let caption = format!(
        "reactions on the subject, {} Hz; centre of pressure from {} N on",
        rounded(rate_hz),
        mocapd_take::foreign::force_plates::LOADED_N
    );
    let marker = marker_traces(plot);
    let channels = channel_traces(&part, start_s(&part, plot.rows), plot.channels)?;
    let all_channels = plot_channels(&part)?;
    let n_of_loads = 2 * traces.len() + 1;
    let n_panels = n_of_loads + channels.len();
    let height = (HEAD as u32 + PANEL * n_panels as u32 + TIME_AXIS).max(640);
    sheet((WIDTH, height), |area| {
        let title = format!("Force plates of {}", shortened(plot.name, 60));
        text(area, &title, (24, 26), left_aligned(TITLE, INK))?;
        let of = format!("{} of {n_plates} plates: {caption}", traces.len());
        text(area, &of, (24, 52), left_aligned(BODY, DIM))?;
        let (head, body) = area.split_vertically(HEAD);
        legend(&head)?;
        let (left, right) = body.split_horizontally(LEFT);
        from_above(&left, plot, &traces)?;
        let times = traces.first().map_or(0.0..1.0, |of| span_s(&of.force_n));
        let panels = Panels::new(&right, (n_panels, PANEL), times);
        for (i, of) in traces.iter().enumerate() {
            let force = of.force_n.iter().zip(STYLES).map(|(t, (colour, dash))| (t, colour, dash));
            panels.draw(
                2 * i,
                &format!("force {} (N)", of.plate.number),
                &force.collect::<Vec<_>>(),
            )?;
            // The third coordinate is that of the surface.
            let along = of.cop_mm.iter().zip(STYLES).enumerate();
            let along = along.filter(|(axis, _)| *axis != plot.up.axis);
            let cop: Vec<_> = along.map(|(_, (t, (colour, dash)))| (t, colour, dash)).collect();
            panels.draw(
                2 * i + 1,
                &format!("centre of pressure {} (mm)", of.plate.number),
                &cop,
            )?;
        }
        let label = &plot.motion.info.markers.get(plot.marker);
        let label = label.map_or("marker", |marker| marker.label.as_str());
        let up = ["x", "y", "z"][plot.up.axis];
        let title = format!("{} {up} (mm)", shortened(label, 40));
        let (colour, dash) = STYLES[plot.up.axis];
        panels.draw(n_of_loads - 1, &title, &[(&marker, colour, dash)])?;
        for (i, ((trace, _), &channel)) in channels.iter().zip(plot.channels).enumerate() {
            let title = channel_title(all_channels.get(channel));
            panels.draw(n_of_loads + i, &title, &[(trace, BLUE, Dash::Solid)])?;
        }
        Ok(())
    })
}

/// Colour and dashes of the x, y and z axis.
pub(super) const STYLES: [(RGBColor, Dash); 3] =
    [(BLUE, Dash::Long), (ORANGE, Dash::Short), (VERMILION, Dash::Solid)];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dash {
    Solid,
    Long,
    Short,
}

impl Dash {
    /// Lengths of a dash and of the space after it, pixels.
    fn lengths(self) -> Option<(i32, i32)> {
        match self {
            Self::Solid => None,
            Self::Long => Some((9, 4)),
            Self::Short => Some((3, 3)),
        }
    }
}

/// The frames `rows` of a take.
fn part(info: &MotionInfo, rows: (u64, u64)) -> MotionInfo {
    let mut part = info.clone();
    part.cut(rows.0, rows.1.min(info.n_frames));
    part
}

fn no_samples(what: &str) -> ReportError {
    ReportError::Nothing(format!(
        "the take has no {what}: only takes imported from C3D files without --drop-foreign have them, and recordings of \
         devices that send them"
    ))
}

fn plate_traces(
    plot: &ForcesPlot<'_>,
    part: &MotionInfo,
    mut loads: PlateLoads<'_>,
) -> Result<Vec<PlateTraces>, ReportError> {
    let all = loads.plates().plates.clone();
    if all.is_empty() {
        let unusable = loads.plates().unusable.iter();
        let reasons: Vec<String> =
            unusable.map(|p| format!("{}: {}", p.number, p.reason)).collect();
        return Err(ReportError::Nothing(format!(
            "no force plate can be used: {}",
            reasons.join("; ")
        )));
    }
    let chosen = chosen(plot.plates, &all)?;
    let (ratio, rate_hz) = (loads.samples_per_frame(), loads.rate_hz());
    let n = part.n_frames.saturating_mul(ratio as u64);
    let trace = || Trace::new(plot.rows.0 as f64 / part.rate_hz, rate_hz, n);
    let of_plate = |index: usize| Some((index, PlateTraces::new(all.get(index)?, trace)));
    let mut found: Vec<(usize, PlateTraces)> = chosen.into_iter().filter_map(of_plate).collect();
    let step = n.div_ceil(PATH_POINTS).max(1);
    let mut block = Vec::new();
    let mut row = 0_u64;
    while loads.next_block(&mut block).map_err(mocapd_take::TakeError::from)? > 0 {
        for of_row in block.chunks_exact(all.len().max(1)) {
            for (index, of) in &mut found {
                let Some(load) = of_row.get(*index) else { continue };
                of.force_n.iter_mut().zip(load.force_n).for_each(|(trace, v)| trace.push(v));
                of.cop_mm.iter_mut().zip(load.cop_mm).for_each(|(trace, v)| trace.push(v));
                let is_drawn =
                    row.is_multiple_of(step) && load.cop_mm.iter().all(|v| v.is_finite());
                of.path.extend(is_drawn.then_some(load.cop_mm));
            }
            row += 1;
        }
    }
    for (_, of) in &mut found {
        of.force_n.iter_mut().chain(&mut of.cop_mm).for_each(Trace::end);
    }
    Ok(found.into_iter().map(|(_, of)| of).collect())
}

/// The indices of the plates with these numbers; of the first ones if none is given.
fn chosen(numbers: &[usize], all: &[ForcePlate]) -> Result<Vec<usize>, ReportError> {
    if numbers.is_empty() {
        return Ok((0..all.len().min(PLATES_MAX)).collect());
    }
    if numbers.len() > PLATES_MAX {
        return Err(ReportError::InvalidArgument(format!(
            "{} force plates are too many to plot: give up to {PLATES_MAX} with --plates",
            numbers.len()
        )));
    }
    let index = |&number: &usize| {
        all.iter().position(|plate| plate.number == number).ok_or_else(|| {
            let known: Vec<String> = all.iter().map(|plate| plate.number.to_string()).collect();
            ReportError::InvalidArgument(format!(
                "the take has no usable force plate {number}: it has {}",
                known.join(", ")
            ))
        })
    };
    numbers.iter().map(index).collect()
}

/// The loads of a recording's plates, how many it has, and the rate of the first one.
fn recorded_plate_traces(
    plot: &ForcesPlot<'_>,
    part: &MotionInfo,
) -> Result<(Vec<PlateTraces>, usize, f64), ReportError> {
    let found = recorded::plates(part)?;
    let all: Vec<ForcePlate> = found.iter().map(|(plate, ..)| plate.clone()).collect();
    let Some(&(_, rate_hz, _)) = found.first() else { return Err(no_samples("force plates")) };
    let first_s = start_s(part, plot.rows);
    let mut traces: Vec<Option<PlateTraces>> = all.iter().map(|_| None).collect();
    let chosen = chosen(plot.plates, &all)?;
    for &index in &chosen {
        if let (Some(place), Some((plate, rate_hz, n))) = (traces.get_mut(index), found.get(index))
        {
            *place = Some(PlateTraces::new(plate, || Trace::new(first_s, *rate_hz, *n)));
        }
    }
    let longest = found.iter().map(|(_, _, n)| *n).max().unwrap_or(0);
    let step = longest.div_ceil(PATH_POINTS).max(1);
    let mut row = vec![0_u64; all.len()];
    recorded::for_each_load(part, |plate, (time_s, force_n, cop_mm)| {
        let (Some(Some(of)), Some(row)) = (traces.get_mut(plate), row.get_mut(plate)) else {
            return;
        };
        let at_s = first_s + time_s;
        of.force_n.iter_mut().zip(force_n).for_each(|(trace, v)| trace.push_at(at_s, v));
        of.cop_mm.iter_mut().zip(cop_mm).for_each(|(trace, v)| trace.push_at(at_s, v));
        let is_drawn = row.is_multiple_of(step) && cop_mm.iter().all(|v| v.is_finite());
        of.path.extend(is_drawn.then_some(cop_mm));
        *row += 1;
    })?;
    for of in traces.iter_mut().flatten() {
        of.force_n.iter_mut().chain(&mut of.cop_mm).for_each(Trace::end);
    }
    let in_order = chosen.iter().filter_map(|&index| traces.get_mut(index)?.take());
    Ok((in_order.collect(), all.len(), rate_hz))
}

/// The height of the marker.
fn marker_traces(plot: &ForcesPlot<'_>) -> Trace {
    let (first, end) = plot.rows;
    let rate_hz = plot.motion.info.rate_hz.max(f64::MIN_POSITIVE);
    let mut trace = Trace::new(first as f64 / rate_hz, rate_hz, end.saturating_sub(first));
    for at in marker_path(plot) {
        trace.push(at.map_or(f64::NAN, |at| at[plot.up.axis]));
    }
    trace.end();
    trace
}

/// The positions of the marker in the frames of the plot.
fn marker_path(plot: &ForcesPlot<'_>) -> Vec<Option<[f64; 3]>> {
    let column = Column::of(plot.motion, plot.marker);
    let rows = usize::try_from(plot.rows.0).unwrap_or(usize::MAX)
        ..usize::try_from(plot.rows.1).unwrap_or(usize::MAX).min(column.0.len());
    column.0.get(rows).unwrap_or_default().to_vec()
}

/// From the first sample of any trace to the last of any.
pub(super) fn span_s(traces: &[Trace]) -> Range<f64> {
    let spans = traces.iter().map(Trace::span_s);
    spans.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0.0..1.0)
}

fn rounded(rate_hz: f64) -> f64 {
    (rate_hz * 100.0).round() / 100.0
}

/// Panels one below another with a common axis of times.
pub(super) struct Panels<'a> {
    areas: Vec<Area<'a>>,
    times: Range<f64>,
}

impl<'a> Panels<'a> {
    /// `n` panels of a height.
    pub(super) fn new(area: &Area<'a>, (n, height): (usize, u32), times: Range<f64>) -> Self {
        let mut areas = Vec::with_capacity(n);
        let mut rest = area.clone();
        for _ in 1..n {
            let (top, below) = rest.split_vertically(height as i32);
            areas.push(top);
            rest = below;
        }
        let (last, _) = rest.split_vertically((height + TIME_AXIS) as i32);
        areas.push(last);
        Self { areas, times }
    }

    /// Draws curves in a panel.
    pub(super) fn draw(
        &self,
        index: usize,
        title: &str,
        traces: &[(&Trace, RGBColor, Dash)],
    ) -> DrawResult {
        let Some(area) = self.areas.get(index) else { return Ok(()) };
        let axes = Axes {
            x: self.times.clone(),
            y: range(traces.iter().flat_map(|(trace, ..)| trace.values())),
            x_title: if index + 1 == self.areas.len() { "time (s)" } else { "" },
            y_title: "",
            margins: [20, 24, 2, 4],
        };
        let mut chart = panel(area, &axes)?;
        // Above the panel: long numbers and names do not fit at its side.
        text(area, title, (74, 10), left_aligned(BODY, INK))?;
        for (trace, colour, dash) in traces {
            for run in trace.runs() {
                match dash.lengths() {
                    None => {
                        chart.draw_series(LineSeries::new(run, colour.stroke_width(1)))?;
                    }
                    Some((length, space)) => {
                        let style = colour.stroke_width(1);
                        chart.draw_series(DashedLineSeries::new(run, length, space, style))?;
                    }
                }
            }
        }
        Ok(())
    }
}

pub(super) fn legend(area: &Area<'_>) -> DrawResult {
    let y = 26;
    for (axis, (colour, dash)) in STYLES.into_iter().enumerate() {
        let x = WIDTH as i32 - 240 + 80 * axis as i32;
        let (length, space) = dash.lengths().unwrap_or((28, 0));
        let mut at = x;
        while at < x + 28 {
            let end = (at + length).min(x + 28);
            area.draw(&PathElement::new(vec![(at, y), (end, y)], colour.stroke_width(2)))?;
            at = end + space;
        }
        text(area, ["x", "y", "z"][axis], (x + 36, y), left_aligned(BODY, INK))?;
    }
    Ok(())
}

/// Draws the plates, the centres of pressure and the path of the marker, seen from above with both axes at the same scale.
fn from_above(area: &Area<'_>, plot: &ForcesPlot<'_>, traces: &[PlateTraces]) -> DrawResult {
    let (right, away) = ((plot.up.axis + 1) % 3, (plot.up.axis + 2) % 3);
    // Seen from above the two axes turn to the left, from below to the right.
    let flat = |at: [f64; 3]| (at[right], plot.up.sign * at[away]);
    let path: Vec<Option<(f64, f64)>> =
        marker_path(plot).into_iter().map(|at| at.map(flat)).collect();
    let corners = |of: &PlateTraces| of.plate.geometry.corners_mm().map(flat);
    let all = || traces.iter().flat_map(corners).chain(path.iter().copied().flatten());
    let (xs, ys) = (range(all().map(|p| p.0)), range(all().map(|p| p.1)));
    let (width, height) = area.dim_in_pixel();
    let (left, top, room_x) = (40.0, 46.0, f64::from(width) - 80.0);
    let room_y = (f64::from(height) - 150.0).min(700.0);
    let scale = (room_x / (xs.end - xs.start)).min(room_y / (ys.end - ys.start));
    let (mid_x, mid_y) = (0.5 * (xs.start + xs.end), 0.5 * (ys.start + ys.end));
    let place = |(x, y): (f64, f64)| {
        let px = left + 0.5 * room_x + (x - mid_x) * scale;
        let py = top + 0.5 * room_y - (y - mid_y) * scale;
        (px.round() as i32, py.round() as i32)
    };
    text(area, "from above", (40, 18), left_aligned(BODY, INK))?;
    for run in runs(path.iter().map(Option::is_some)) {
        let line: Vec<(i32, i32)> =
            path.get(run).unwrap_or_default().iter().copied().flatten().map(place).collect();
        area.draw(&PathElement::new(line, DIM.stroke_width(1)))?;
    }
    for (of, colour) in traces.iter().zip(PLATE_COLOURS) {
        let mut outline: Vec<(i32, i32)> = corners(of).map(place).to_vec();
        outline.extend(outline.first().copied());
        area.draw(&PathElement::new(outline, INK.stroke_width(1)))?;
        let (x, y) = place(flat(of.plate.geometry.corners_mm()[0]));
        let centre = place(flat(of.plate.geometry.centre_mm()));
        let at = (x + (centre.0 - x).signum() * 12, y + (centre.1 - y).signum() * 12);
        text(area, &of.plate.number.to_string(), at, centred(BODY, colour))?;
        for &at in &of.path {
            area.draw(&Circle::new(place(flat(at)), 1, colour.filled()))?;
        }
    }
    let names = ["x", "y", "z"];
    let base = (top + room_y) as i32 + 40;
    let corner = (60, base);
    area.draw(&PathElement::new(vec![corner, (94, base)], DIM.stroke_width(1)))?;
    text(area, names[right], (106, base), centred(SMALL, DIM))?;
    area.draw(&PathElement::new(vec![corner, (60, base - 34)], DIM.stroke_width(1)))?;
    let away_name =
        if plot.up.sign < 0.0 { format!("-{}", names[away]) } else { names[away].to_owned() };
    text(area, &away_name, (60, base - 46), centred(SMALL, DIM))?;
    let bar = ((500.0 * scale).round() as i32).max(1);
    area.draw(&PathElement::new(vec![(170, base), (170 + bar, base)], INK.stroke_width(3)))?;
    text(area, "500 mm", (170, base + 18), left_aligned(BODY, INK))?;
    text(
        area,
        "plates, centres of pressure (dots), marker (line)",
        (40, base + 44),
        left_aligned(SMALL, DIM),
    )
}
