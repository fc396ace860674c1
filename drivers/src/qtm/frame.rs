//! Data packets in both directions: the header of a frame, its components of 3D markers, and the others by their modules.

use super::{
    bodies::{BodiesToSend, BodyComponent, BodyComponentKind},
    packet::{PacketKind, put_packet},
    sampled::{self, DeviceSamples, SampledComponentKind, SamplesToSend},
};
use crate::bytes::{Cursor, WireValue};

/// Bytes of a component before its markers: size, type, count and two rates.
const COMPONENT_HEADER_BYTES: usize = 16;

/// Components of 3D markers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum MarkerComponentKind {
    /// Labelled markers.
    Labelled = 1,
    /// Unlabelled markers, with ids.
    Unlabelled = 2,
    /// Labelled markers with residuals.
    LabelledWithResiduals = 9,
    /// Unlabelled markers with ids and residuals.
    UnlabelledWithResiduals = 10,
}

impl MarkerComponentKind {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 4] = [
        Self::Labelled,
        Self::Unlabelled,
        Self::LabelledWithResiduals,
        Self::UnlabelledWithResiduals,
    ];

    fn of(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| u32::from(*kind as u8) == code)
    }

    /// Its name in commands.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Labelled => "3D",
            Self::Unlabelled => "3DNoLabels",
            Self::LabelledWithResiduals => "3DRes",
            Self::UnlabelledWithResiduals => "3DNoLabelsRes",
        }
    }

    /// Whether its markers follow the labels of the 3D settings, in their order.
    #[must_use]
    pub fn is_labelled(self) -> bool {
        matches!(self, Self::Labelled | Self::LabelledWithResiduals)
    }

    fn has_residuals(self) -> bool {
        matches!(self, Self::LabelledWithResiduals | Self::UnlabelledWithResiduals)
    }

    /// Bytes of one marker, from protocol version 1.8 on.
    #[must_use]
    pub fn marker_bytes(self) -> usize {
        12 + 4 * usize::from(!self.is_labelled()) + 4 * usize::from(self.has_residuals())
    }
}

/// A marker of a component.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WireMarker {
    /// x, y, z in millimetres; NaN when the marker is missing.
    pub position_mm: [f32; 3],
    /// Identifies an unlabelled marker between frames; 0 for labelled ones.
    pub id: u32,
    /// Residual; 0 where the component has none.
    pub residual_mm: f32,
}

/// A component of 3D markers.
#[derive(Debug, Clone, Copy)]
pub struct MarkerComponent<'a> {
    /// What its markers have.
    pub kind: MarkerComponentKind,
    /// 2D frames lost between cameras and QTM, per thousand, over the last second.
    pub drop_rate: u16,
    /// 2D frames whose numbers differed from the others', per thousand, over the last second.
    pub out_of_sync_rate: u16,
    markers: &'a [u8],
}

impl<'a> MarkerComponent<'a> {
    /// Reads a component's content; `None` when its size and its count differ.
    fn read(kind: MarkerComponentKind, content: &'a [u8]) -> Option<Self> {
        let mut content = Cursor::new(content);
        let count = usize::try_from(content.get::<u32>()?).ok()?;
        let (drop_rate, out_of_sync_rate) = (content.get()?, content.get()?);
        let markers = content.bytes(count.checked_mul(kind.marker_bytes())?)?;
        content.end(Self { kind, drop_rate, out_of_sync_rate, markers })
    }

    /// Number of markers.
    #[must_use]
    pub fn n_markers(&self) -> usize {
        self.markers.len() / self.kind.marker_bytes()
    }

    /// The markers.
    pub fn markers(&self) -> impl Iterator<Item = WireMarker> + use<'a> {
        let kind = self.kind;
        self.markers.chunks_exact(kind.marker_bytes()).filter_map(move |marker| {
            let mut marker = Cursor::new(marker);
            Some(WireMarker {
                position_mm: marker.get()?,
                id: if kind.is_labelled() { 0 } else { marker.get()? },
                residual_mm: if kind.has_residuals() { marker.get()? } else { 0.0 },
            })
        })
    }
}

/// The header of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameHeader {
    /// Microseconds since QTM started its clock.
    pub time_us: u64,
    /// Number of the frame. Live, it may stand still.
    pub number: u32,
}

impl FrameHeader {
    /// The header of a data packet.
    pub(super) fn of(body: &[u8]) -> Option<Self> {
        let mut body = Cursor::new(body);
        Some(Self { time_us: body.get()?, number: body.get()? })
    }
}

/// A part of a frame.
#[derive(Debug, Clone, Copy)]
pub enum FrameComponent<'a> {
    /// Markers.
    Markers(MarkerComponent<'a>),
    /// Rigid bodies with matrices.
    Bodies(BodyComponent<'a>),
    /// A component of rigid bodies whose size and count differ: it is skipped, and costs the frame no marker.
    UnreadableBodies,
    /// Samples of an analog device, or of a force plate.
    Samples(DeviceSamples<'a>),
    /// A component of samples whose size and counts differ: it is skipped, and costs the frame no marker.
    UnreadableSamples,
}

/// Reads a data packet, and calls `on_component` for each of its components of 3D markers. `None`, and no more calls, at
/// the first component that does not fit.
pub fn read_frame<'a>(
    body: &'a [u8],
    on_component: &mut dyn FnMut(FrameHeader, MarkerComponent<'a>),
) -> Option<FrameHeader> {
    read_components(body, &mut |header, component| {
        if let FrameComponent::Markers(markers) = component {
            on_component(header, markers);
        }
    })
}

/// Reads a data packet as [`read_frame`] does, with its bodies and samples. Bodies with angles, whose definition each user of
/// QTM chooses, are skipped.
pub fn read_components<'a>(
    body: &'a [u8],
    on_component: &mut dyn FnMut(FrameHeader, FrameComponent<'a>),
) -> Option<FrameHeader> {
    let mut body = Cursor::new(body);
    let header = FrameHeader { time_us: body.get()?, number: body.get()? };
    // Each takes 8 bytes at least, so that a false count ends with the bytes.
    for _ in 0..body.get::<u32>()? {
        let size = usize::try_from(body.get::<u32>()?).ok()?;
        let kind = body.get::<u32>()?;
        let content = body.bytes(size.checked_sub(8)?)?;
        if let Some(kind) = MarkerComponentKind::of(kind) {
            on_component(header, FrameComponent::Markers(MarkerComponent::read(kind, content)?));
        } else if let Some(kind) = BodyComponentKind::of(kind).filter(|kind| kind.has_matrices()) {
            let bodies = BodyComponent::read(kind, content);
            let bodies = bodies.map_or(FrameComponent::UnreadableBodies, FrameComponent::Bodies);
            on_component(header, bodies);
        } else if let Some(kind) = SampledComponentKind::of(kind) {
            // First as a whole: of one that cannot be read, nothing is.
            if sampled::read(kind, content, &mut |_| {}).is_none() {
                on_component(header, FrameComponent::UnreadableSamples);
                continue;
            }
            let on_device = &mut |device| on_component(header, FrameComponent::Samples(device));
            sampled::read(kind, content, on_device)?;
        }
    }
    body.end(header)
}

/// What a server sends of one component.
#[derive(Debug, Clone, Copy)]
pub struct ComponentToSend<'a> {
    /// What its markers have.
    pub kind: MarkerComponentKind,
    /// 2D frames lost, and out of sync, per thousand.
    pub rates: [u16; 2],
    /// The markers.
    pub markers: &'a [WireMarker],
}

impl ComponentToSend<'_> {
    /// Its bytes in a packet.
    #[must_use]
    pub fn bytes(&self) -> usize {
        COMPONENT_HEADER_BYTES + self.markers.len() * self.kind.marker_bytes()
    }

    fn put(&self, out: &mut Vec<u8>) {
        let Self { kind, rates, markers } = *self;
        (self.bytes() as u32).put(out);
        u32::from(kind as u8).put(out);
        (markers.len() as u32).put(out);
        rates.into_iter().for_each(|rate| rate.put(out));
        for marker in markers {
            marker.position_mm.put(out);
            if !kind.is_labelled() {
                marker.id.put(out);
            }
            if kind.has_residuals() {
                marker.residual_mm.put(out);
            }
        }
    }
}

/// What a server sends of one component of samples.
#[derive(Debug, Clone)]
pub(super) struct SampledComponent<'a> {
    /// Its type.
    pub(super) kind: SampledComponentKind,
    /// Its devices or plates.
    pub(super) devices: Vec<SamplesToSend<'a>>,
}

/// Bytes of a component of samples before its devices: size, type and their number.
pub(super) const COMPONENT_BYTES: usize = 12;

/// Bytes of a device before its values, at most: id, and numbers of channels and samples, and of the first.
pub(super) const DEVICE_BYTES: usize = 16;

impl SampledComponent<'_> {
    /// Its bytes in a packet, at most.
    pub(super) fn bytes(&self) -> usize {
        let device = |device: &SamplesToSend<'_>| DEVICE_BYTES + size_of_val(device.samples);
        COMPONENT_BYTES + self.devices.iter().map(device).sum::<usize>()
    }
}

/// A component to send.
#[derive(Debug, Clone)]
pub(super) enum AnyComponent<'a> {
    Markers(ComponentToSend<'a>),
    Bodies(BodiesToSend<'a>),
    Samples(SampledComponent<'a>),
}

impl AnyComponent<'_> {
    /// Its bytes in a packet.
    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Markers(component) => component.bytes(),
            Self::Bodies(component) => component.bytes(),
            Self::Samples(component) => component.bytes(),
        }
    }

    fn put(&self, out: &mut Vec<u8>) {
        match self {
            Self::Markers(component) => component.put(out),
            Self::Bodies(component) => component.put(out),
            Self::Samples(component) => sampled::put(component.kind, &component.devices, out),
        }
    }
}

/// Bytes of a data packet before its components: packet header, time, number and count.
pub(super) const FRAME_HEADER_BYTES: usize = 24;

/// Appends a data packet with components of markers.
pub fn put_frame(header: FrameHeader, components: &[ComponentToSend<'_>], out: &mut Vec<u8>) {
    let components: Vec<_> = components.iter().map(|c| AnyComponent::Markers(*c)).collect();
    put_components(header, &components, out);
}

/// Appends a data packet.
pub(super) fn put_components(
    header: FrameHeader,
    components: &[AnyComponent<'_>],
    out: &mut Vec<u8>,
) {
    put_packet(PacketKind::Data, out, |out| {
        header.time_us.put(out);
        header.number.put(out);
        (components.len() as u32).put(out);
        components.iter().for_each(|component| component.put(out));
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::qtm::packet::{MISSING, Packet};

    fn markers() -> [WireMarker; 2] {
        [
            WireMarker { position_mm: [1.0, -2.0, 0.5], id: 7, residual_mm: 0.25 },
            WireMarker { position_mm: [MISSING; 3], id: 0x0102_0304, residual_mm: 0.0 },
        ]
    }

    /// The layout of "Data packet" and "3D components" in the documents, written out by hand.
    #[test]
    fn a_frame_has_the_documented_bytes() {
        let markers = markers();
        let component = |kind| ComponentToSend { kind, rates: [3, 0x0104], markers: &markers[..1] };
        let kinds = [MarkerComponentKind::Labelled, MarkerComponentKind::UnlabelledWithResiduals];
        let components = kinds.map(component);
        let mut out = Vec::new();
        put_frame(FrameHeader { time_us: 0x0102, number: 5 }, &components, &mut out);
        let (x, y, z) = ([0, 0, 0x80, 0x3F], [0, 0, 0, 0xC0], [0, 0, 0, 0x3F]);
        let expected: Vec<&[u8]> = vec![
            &[88, 0, 0, 0, 3, 0, 0, 0],
            &[2, 1, 0, 0, 0, 0, 0, 0],
            &[5, 0, 0, 0, 2, 0, 0, 0],
            &[28, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 3, 0, 4, 1],
            &x,
            &y,
            &z,
            &[36, 0, 0, 0, 10, 0, 0, 0, 1, 0, 0, 0, 3, 0, 4, 1],
            &x,
            &y,
            &z,
            &[7, 0, 0, 0],
            &[0, 0, 0x80, 0x3E],
        ];
        assert_eq!(out, expected.concat());
    }

    #[test]
    fn a_missing_marker_has_all_bits_set() {
        let components = [ComponentToSend {
            kind: MarkerComponentKind::Labelled,
            rates: [0; 2],
            markers: &markers()[1..],
        }];
        let mut out = Vec::new();
        put_frame(FrameHeader::default(), &components, &mut out);
        assert_eq!(out[out.len() - 12..], [0xFF; 12]);
    }

    #[test]
    fn every_component_reads_back() {
        for kind in MarkerComponentKind::ALL {
            let header = FrameHeader { time_us: u64::MAX - 1, number: 9 };
            let markers = markers();
            let components = [ComponentToSend { kind, rates: [1000, 2], markers: &markers }; 2];
            let mut out = Vec::new();
            put_frame(header, &components, &mut out);
            assert_eq!(out.len(), 24 + 2 * components[0].bytes());
            let mut n_components = 0;
            let packet = Packet::of(&out).unwrap();
            let read = read_frame(packet.body, &mut |found, component| {
                n_components += 1;
                assert_eq!(found, header);
                assert_eq!((component.kind, component.n_markers()), (kind, 2));
                assert_eq!((component.drop_rate, component.out_of_sync_rate), (1000, 2));
                let first = component.markers().next().unwrap();
                assert_eq!(first.position_mm, [1.0, -2.0, 0.5]);
                assert_eq!(first.id, if kind.is_labelled() { 0 } else { 7 });
                assert_eq!(first.residual_mm, if kind.has_residuals() { 0.25 } else { 0.0 });
                assert!(component.markers().nth(1).unwrap().position_mm.iter().all(|v| v.is_nan()));
            });
            assert_eq!((read, n_components), (Some(header), 2));
        }
    }

    #[test]
    fn components_that_are_not_read_are_skipped() {
        // A 2D component (7) in front of a 3D component.
        let mut body = Vec::new();
        for part in [
            &[1_u8, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0][..],
            &[64, 0, 0, 0, 7, 0, 0, 0],
            &[0; 56],
        ] {
            body.extend_from_slice(part);
        }
        ComponentToSend { kind: MarkerComponentKind::Labelled, rates: [0; 2], markers: &[] }
            .put(&mut body);
        let mut found = 0;
        assert!(read_frame(&body, &mut |_, _| found += 1).is_some());
        assert_eq!(found, 1);
        for cut in 0..body.len() {
            assert_eq!(read_frame(&body[..cut], &mut |_, _| {}), None, "{cut}");
        }
    }

    #[test]
    fn sizes_and_counts_that_lie_are_refused() {
        let component = ComponentToSend {
            kind: MarkerComponentKind::Labelled,
            rates: [0; 2],
            markers: &markers(),
        };
        let mut out = Vec::new();
        put_frame(FrameHeader::default(), &[component], &mut out);
        let body = Packet::of(&out).unwrap().body.to_vec();
        for (at, value) in [
            (12, 2),
            (12, u32::MAX),
            (16, 0),
            (16, 7),
            (16, 41),
            (16, u32::MAX),
            (24, 1),
            (24, 3),
            (24, u32::MAX),
        ] {
            let mut body = body.clone();
            body[at..at + 4].copy_from_slice(&value.to_le_bytes());
            assert_eq!(read_frame(&body, &mut |_, _| {}), None, "{value} at {at}");
        }
    }
}
