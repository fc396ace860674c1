//! Reads a QTM RT server with a client that is not ours, the crate qualisys, for `tests/oracle/check_qtm.py`.
//!
//!     qtm_client PORT tcp|udp
//!
//! PORT is the server's little-endian port on this machine. One line of JSON for everything that arrives, until its standard input
//! is closed. Floats are exact: those of float32 are printed as double precision has them.

#![expect(clippy::print_stdout, reason = "what an example is for")]

use std::{
    env,
    error::Error,
    fmt::Write,
    io::{self, Read},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::Builder,
    time::Duration,
};

use qualisys::{
    Component, ComponentOptions, ComponentType, DataFrame, Packet, Parameter, Protocol, StreamRate,
    components::Marker,
};

const COMPONENTS: [ComponentType; 4] = [
    ComponentType::Markers3d,
    ComponentType::Markers3dResidual,
    ComponentType::Markers3dNoLabels,
    ComponentType::Markers3dNoLabelsResidual,
];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [port, transport] = arguments.as_slice() else { return Err("PORT tcp|udp".into()) };
    let is_udp = transport == "udp";
    let builder = Protocol::builder().read_timeout(Duration::from_millis(200));
    // It takes the base port, which is one below.
    let mut client = builder.connect("127.0.0.1", port.parse::<u16>()?.saturating_sub(1))?;
    let (major, minor) = client.version();
    println!("{{\"kind\":\"version\",\"version\":\"{major}.{minor}\"}}");
    println!("{{\"kind\":\"address\",\"address\":\"{}\"}}", client.local_addr()?);
    let datagram_port = if is_udp { Some(client.enable_udp_stream(0)?) } else { None };
    if let Some(port) = datagram_port {
        println!("{{\"kind\":\"datagrams\",\"port\":{port}}}");
    }
    let settings = client.get_parameters(&[Parameter::ThreeD])?;
    println!("{{\"kind\":\"settings\",\"xml\":{}}}", quoted(&settings)?);
    let (rate, options) = (StreamRate::AllFrames, ComponentOptions::default());
    match datagram_port {
        Some(port) => client.stream_frames_udp(rate, &COMPONENTS, &options, port, None)?,
        None => client.stream_frames(rate, &COMPONENTS, &options)?,
    }
    let is_over = Arc::new(AtomicBool::new(false));
    let over = Arc::clone(&is_over);
    Builder::new().name("stdin".to_owned()).spawn(move || {
        io::stdin().read_to_end(&mut Vec::new()).ok();
        over.store(true, Ordering::Relaxed);
    })?;
    while !is_over.load(Ordering::Relaxed) {
        let packet = if is_udp { client.receive_udp() } else { client.receive() };
        match packet? {
            Packet::Data(frame) => println!("{}", line(&frame)?),
            // Its word for a time without packets, too.
            Packet::NoMoreData => {}
            other => {
                println!("{{\"kind\":\"other\",\"packet\":{}}}", quoted(&format!("{other:?}"))?);
            }
        }
    }
    Ok(client.stream_frames_stop()?)
}

/// A frame as JSON: of each marker its id, its position, and its residual, of those that its component has.
fn line(frame: &DataFrame) -> Result<String, Box<dyn Error>> {
    let mut out = format!("{{\"kind\":\"frame\",\"number\":{}", frame.frame_number);
    write!(out, ",\"time_us\":{},\"components\":{{", frame.timestamp)?;
    for (index, component) in frame.components.iter().enumerate() {
        let (kind, markers) = match component {
            Component::Markers3d(markers) => (ComponentType::Markers3d, markers),
            Component::Markers3dResidual(markers) => (ComponentType::Markers3dResidual, markers),
            Component::Markers3dNoLabels(markers) => (ComponentType::Markers3dNoLabels, markers),
            Component::Markers3dNoLabelsResidual(markers) => {
                (ComponentType::Markers3dNoLabelsResidual, markers)
            }
            other => return Err(format!("nobody asked for {:?}", other.component_type()).into()),
        };
        let comma = if index == 0 { "" } else { "," };
        let markers: Vec<_> = markers.markers.iter().map(values).collect();
        write!(out, "{comma}\"{kind}\":[{}]", markers.join(","))?;
    }
    out.push_str("}}");
    Ok(out)
}

fn values(marker: &Marker) -> String {
    let point = marker.position;
    let number = |value: f32| {
        if value.is_nan() { "null".to_owned() } else { f64::from(value).to_string() }
    };
    let id = marker.id.map(|id| id.to_string());
    let floats = [point.x, point.y, point.z].into_iter().chain(marker.residual).map(number);
    let values: Vec<_> = id.into_iter().chain(floats).collect();
    format!("[{}]", values.join(","))
}

/// Text as JSON has it.
fn quoted(text: &str) -> Result<String, std::fmt::Error> {
    let mut out = String::from("\"");
    for character in text.chars() {
        match character {
            '"' | '\\' => write!(out, "\\{character}")?,
            control if control < ' ' => write!(out, "\\u{:04x}", u32::from(control))?,
            other => out.push(other),
        }
    }
    out.push('"');
    Ok(out)
}
