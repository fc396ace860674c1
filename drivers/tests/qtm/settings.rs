//! Settings: what our server states satisfies the vendor's client, and hostile documents cost nothing.

use std::time::{Duration, Instant};

use mocapd_drivers::qtm::{
    AnalogDevice, BodySettings, ForcePlate, LABELS_MAX, ServedSettings, Settings, SettingsRequest,
};

const BOTH: SettingsRequest =
    SettingsRequest { general: true, markers: true, bodies: false, analog: false, force: false };
use roxmltree::{Document, Node};

fn served() -> ServedSettings {
    let labels = ["head", "a <b> & \"c\"", "", "\u{1F9CD}", "tab\tand\u{1}"];
    ServedSettings {
        frequency_hz: 240.0,
        up_axis: "+Z",
        labels: labels.map(str::to_owned).to_vec(),
        ..ServedSettings::default()
    }
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn text<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    child(node, name).map(|child| child.text().unwrap_or_default())
}

/// What `SettingsDeserializer::Deserialize3DSettings` of the C++ SDK requires.
fn markers_satisfy_the_sdk(root: Node<'_, '_>) -> Option<usize> {
    let markers = root.children().find(|child| child.has_tag_name("The_3D"))?;
    let axis = text(markers, "AxisUpwards")?.to_ascii_lowercase();
    ["+x", "-x", "+y", "-y", "+z", "-z"].contains(&axis.as_str()).then_some(())?;
    text(markers, "CalibrationTime")?;
    let stated: usize = text(markers, "Labels")?.parse().ok()?;
    let found = markers.children().filter(|child| child.has_tag_name("Label")).count();
    (stated == found).then_some(found)
}

/// What `DeserializeGeneralSettings` requires of a system without cameras.
fn general_satisfies_the_sdk(root: Node<'_, '_>, minor: u32) -> Option<()> {
    fn is_bool(node: Node<'_, '_>, name: &str) -> Option<()> {
        text(node, name).filter(|t| ["true", "false"].contains(t)).map(drop)
    }
    let general = root.children().find(|child| child.has_tag_name("General"))?;
    text(general, "Frequency")?.parse::<f64>().ok()?;
    text(general, "Capture_Time")?.parse::<f32>().ok()?;
    is_bool(general, "Start_On_External_Trigger")?;
    if minor > 14 {
        for name in ["NO", "NC", "Software"] {
            is_bool(general, &format!("Start_On_Trigger_{name}"))?;
        }
    }
    let time_base = child(general, "External_Time_Base")?;
    is_bool(time_base, "Enabled")?;
    let one_of = |name, values: &[&str]| {
        values.contains(&text(time_base, name)?.to_ascii_lowercase().as_str()).then_some(())
    };
    one_of("Signal_Source", &["control port", "ir receiver", "smpte", "irig", "video sync"])?;
    one_of("Signal_Mode", &["periodic", "non-periodic"])?;
    one_of("Signal_Edge", &["negative", "positive"])?;
    for name in
        ["Frequency_Multiplier", "Frequency_Divisor", "Frequency_Tolerance", "Signal_Shutter_Delay"]
    {
        text(time_base, name)?.parse::<u32>().ok()?;
    }
    text(time_base, "Nominal_Frequency").filter(|t| *t == "None" || t.parse::<f32>().is_ok())?;
    text(time_base, "Non_Periodic_Timeout")?.parse::<f32>().ok()?;
    let all = ["Processing_Actions", "RealTime_Processing_Actions", "Reprocessing_Actions"];
    for (index, name) in all.into_iter().enumerate().take(if minor > 13 { 3 } else { 1 }) {
        let actions = child(general, name)?;
        text(actions, "Tracking")?;
        let mut required = vec!["AIM", "Track6DOF", "ForceData"];
        if minor > 13 {
            required.push("PreProcessing2D");
        }
        if minor > 11 {
            required.push("GazeVector");
        }
        if index != 1 {
            required.extend([
                "TwinSystemMerge",
                "SplineFill",
                "ExportTSV",
                "ExportC3D",
                "ExportMatlabFile",
            ]);
        }
        if index != 1 && minor > 11 {
            required.push("ExportAviFile");
        }
        required.into_iter().try_for_each(|name| is_bool(actions, name))?;
    }
    Some(())
}

/// What `Deserialize6DOFSettings` requires; up to version 1.20 also what its predecessors did, which read `Point`.
fn bodies_satisfy_the_sdk(root: Node<'_, '_>, minor: u32) -> Option<usize> {
    fn number(node: Node<'_, '_>, name: &str) -> Option<()> {
        text(node, name)?.trim().parse::<f32>().ok().map(drop)
    }
    let bodies = child(root, "The_6D")?;
    let stated: usize = text(bodies, "Bodies")?.parse().ok()?;
    let of = |parent: Node<'_, '_>, name: &'static str| {
        parent.children().filter(move |child| child.has_tag_name(name)).count()
    };
    for body in bodies.children().filter(|child| child.has_tag_name("Body")) {
        text(body, "Name")?;
        if minor <= 20 {
            text(body, "RGBColor")?.parse::<i32>().ok()?;
            for point in body.children().filter(|child| child.has_tag_name("Point")) {
                ["X", "Y", "Z"].iter().try_for_each(|axis| number(point, axis))?;
            }
            continue;
        }
        let colour = child(body, "Color")?;
        ["R", "G", "B"]
            .iter()
            .try_for_each(|part| colour.attribute(*part)?.parse::<u8>().ok().map(drop))?;
        number(body, "MaximumResidual")?;
        text(body, "MinimumMarkersInBody")?.parse::<u32>().ok()?;
        number(body, "BoneLengthTolerance")?;
        child(body, "Filter")?.attribute("Preset")?;
        if minor > 23 {
            (text(body, "Enabled")? == "true").then_some(())?;
        }
        child(body, "Points")?;
        // Type and body of origin and orientation are the same.
        let [origin, orientation] = ["Data_origin", "Data_orientation"].map(|name| {
            let node = child(body, name)?;
            Some((node.text()?.to_owned(), node.attribute("Relative_body")?.to_owned()))
        });
        (origin? == orientation?).then_some(())?;
    }
    if (16..=20).contains(&minor) {
        let angles = child(bodies, "Euler")?;
        ["First", "Second", "Third"].iter().try_for_each(|name| text(angles, name).map(drop))?;
    }
    (stated == of(bodies, "Body")).then_some(stated)
}

/// What `DeserializeAnalogSettings` and `DeserializeForceSettings` require: how many devices and plates are read.
fn samples_satisfy_the_sdk(root: Node<'_, '_>, minor: u32) -> Option<(usize, usize)> {
    fn numbers(node: Node<'_, '_>, names: &[&str]) -> Option<()> {
        names.iter().try_for_each(|name| text(node, name)?.parse::<f32>().ok().map(drop))
    }
    fn unsigned(node: Node<'_, '_>, name: &str) -> Option<u32> {
        text(node, name)?.parse().ok()
    }
    let (analog, force) = (child(root, "Analog")?, child(root, "Force")?);
    if minor < 11 {
        text(analog, "Unit")?;
    }
    let (mut n_devices, mut n_plates) = (0, 0);
    for device in analog.children().filter(|child| child.has_tag_name("Device")) {
        unsigned(device, "Device_ID")?;
        unsigned(device, "Frequency")?;
        text(device, "Device_Name")?;
        numbers(child(device, "Range")?, &["Min", "Max"])?;
        let stated = unsigned(device, "Channels")? as usize;
        let of = |name: &'static str| device.children().filter(move |c| c.has_tag_name(name));
        let is_whole = |channel: &Node<'_, '_>| {
            child(*channel, "Label").is_some() && child(*channel, "Unit").is_some()
        };
        let found = match minor < 11 {
            true => of("Label").count(),
            false => of("Channel").filter(is_whole).count(),
        };
        (stated == found).then_some(())?;
        n_devices += 1;
    }
    text(force, "Unit_Length")?;
    text(force, "Unit_Force")?;
    for plate in force.children().filter(|child| child.has_tag_name("Plate")) {
        unsigned(plate, "Plate_ID")?;
        unsigned(plate, "Frequency")?;
        if let Some(location) = child(plate, "Location") {
            for corner in ["Corner1", "Corner2", "Corner3", "Corner4"] {
                numbers(child(location, corner)?, &["X", "Y", "Z"])?;
            }
        }
        n_plates += 1;
    }
    Some((n_devices, n_plates))
}

#[test]
fn our_samples_satisfy_the_rules_of_the_cpp_sdk() {
    let channels = vec![("EMG".to_owned(), "V".to_owned()), (String::new(), String::new())];
    let analog = vec![AnalogDevice { id: 1, rate_hz: 1000.5, channels }];
    let (x, y) = (450.0, 300.5);
    let corners_mm = Some([[x, y, 0.0], [-x, y, 0.0], [-x, -y, 0.0], [x, -y, 0.0]]);
    let plate = |corners_mm| ForcePlate { id: 2, rate_hz: 1000.0, corners_mm };
    let plates = vec![plate(None), plate(corners_mm)];
    let served = ServedSettings { analog, plates, ..served() };
    let request = SettingsRequest { analog: true, force: true, ..SettingsRequest::default() };
    for minor in 8..=28 {
        let xml = served.to_xml(minor, request).unwrap();
        let document = Document::parse(&xml).unwrap();
        let found = samples_satisfy_the_sdk(document.root_element(), minor);
        assert_eq!(found, Some((1, 2)), "1.{minor}: {xml}");
    }
}

fn with_bodies() -> ServedSettings {
    let points_mm = vec![[60.0, 0.0, -0.5], [0.0, 1e-3, 60.0]];
    let cup = BodySettings { name: "cup <&>".to_owned(), colour: Some([1, 2, 255]), points_mm };
    let table = BodySettings { name: "table".to_owned(), ..BodySettings::default() };
    ServedSettings { bodies: vec![cup, table], ..served() }
}

#[test]
fn our_bodies_satisfy_the_rules_of_the_cpp_sdk_and_read_back() {
    let request = SettingsRequest { bodies: true, general: true, ..SettingsRequest::default() };
    for minor in 8..=28 {
        let xml = with_bodies().to_xml(minor, request).unwrap();
        let document = Document::parse(&xml).unwrap();
        let found = bodies_satisfy_the_sdk(document.root_element(), minor);
        assert_eq!(found, Some(2), "1.{minor}: {xml}");
        let settings = Settings::parse(&xml).unwrap();
        let bodies = settings.bodies.unwrap();
        assert_eq!(bodies[0], with_bodies().bodies[0], "1.{minor}: {xml}");
        assert_eq!((&*bodies[1].name, bodies[1].points_mm.len()), ("table", 0));
        let angles = settings.angles.map(|names| names.join(" "));
        assert_eq!(angles.as_deref(), (minor > 15).then_some("Roll Pitch Yaw"), "1.{minor}: {xml}");
    }
    let only = SettingsRequest { bodies: true, ..SettingsRequest::default() };
    assert_eq!(served().to_xml(25, only), None, "it has none");
}

/// The example of the documents, with the end of its element corrected, and one of a later version as QTM writes it.
#[test]
fn the_documents_examples_of_bodies_are_read() {
    let point = "<Point><X>10.5</X><Y>9.5</Y><Z>10.5</Z><Virtual>False</Virtual><PhysicalId>1</PhysicalId></Point>";
    let early = format!(
        "<QTM_Parameters_Ver_1.20><The_6D><Bodies>1</Bodies><Body><Name>Body1</Name><RGBColor>ffffff</RGBColor>{point}\
         {point}{point}</Body><Euler><First>Roll</First><Second>Pitch</Second><Third>Yaw</Third></Euler></The_6D>\
         </QTM_Parameters_Ver_1.20>"
    );
    let settings = Settings::parse(&early).unwrap();
    let body =
        |name: &str, colour, points_mm| BodySettings { name: name.to_owned(), colour, points_mm };
    let white = Some([255; 3]);
    assert_eq!(settings.bodies, Some(vec![body("Body1", white, vec![[10.5, 9.5, 10.5]; 3])]));
    assert_eq!(settings.angles.unwrap(), ["Roll", "Pitch", "Yaw"]);
    let late = "<QTM_Parameters_Ver_1.25><The_6D><Body><Name>refined</Name><Enabled>true</Enabled>\
                <Color R=\"0\" G=\"255\" B=\"0\"/><MaximumResidual>20.000000</MaximumResidual><Points>\
                <Point X=\"-67.500000\" Y=\"29.250000\" Z=\"-1.500000\" Virtual=\"0\" PhysicalId=\"0\" Name=\"1\"/>\
                </Points></Body><Body><Name>Table</Name><Points/></Body></The_6D></QTM_Parameters_Ver_1.25>";
    let bodies = Settings::parse(late).unwrap().bodies.unwrap();
    let expected = [
        body("refined", Some([0, 255, 0]), vec![[-67.5, 29.25, -1.5]]),
        body("Table", None, Vec::new()),
    ];
    assert_eq!(bodies, expected);
}

#[test]
fn our_settings_satisfy_the_rules_of_the_cpp_sdk() {
    for minor in 8..=28 {
        let xml = served().to_xml(minor, BOTH).unwrap();
        let document = Document::parse(&xml).unwrap();
        let root = document.root_element();
        assert!(root.has_tag_name(format!("QTM_Parameters_Ver_1.{minor}").as_str()), "{xml}");
        assert_eq!(markers_satisfy_the_sdk(root), Some(5), "{xml}");
        assert_eq!(general_satisfies_the_sdk(root, minor), Some(()), "1.{minor}: {xml}");
    }
}

/// The example of the documents, with their colours in hexadecimal.
#[test]
fn the_documents_example_of_markers_is_read() {
    let xml = "<QTM_Parameters_Ver_1.20>\n    <The_3D>\n        <AxisUpwards>+Z</AxisUpwards>\n        \
               <CalibrationTime>2011.09.23 11:23:11</CalibrationTime>\n        <Labels>2</Labels>\n        \
               <Label>\n             <Name>th12</Name>\n             <RGBColor>ff00ff</RGBColor>\n        </Label>\n        \
               <Label>\n             <Name>r_asis</Name>\n             <RGBColor>00ffff</RGBColor>\n        </Label>\n        \
               <Bones>\n             <Bone From=\"fromName\" To=\"toName\" Color=\"ffff00\" />\n        </Bones>\n    \
               </The_3D>\n</QTM_Parameters_Ver_1.20>";
    let settings = Settings::parse(xml).unwrap();
    assert_eq!(settings.up_axis.as_deref(), Some("+Z"));
    assert_eq!(settings.labels.unwrap(), ["th12", "r_asis"]);
}

#[test]
fn settings_read_back() {
    let settings = Settings::parse(&served().to_xml(25, BOTH).unwrap()).unwrap();
    assert_eq!(settings.frequency_hz, Some(240.0));
    let labels = settings.labels.unwrap();
    assert_eq!(labels, ["head", "a <b> & \"c\"", "", "\u{1F9CD}", "tab_and_"]);
    let sampled = SettingsRequest { analog: true, force: true, ..SettingsRequest::default() };
    assert_eq!(served().to_xml(25, sampled), None, "it has none");
    let channel = |k: u32| (format!("EMG <{k}>"), "V".to_owned());
    let analog = [3, 1].map(|id| AnalogDevice {
        id,
        rate_hz: 2000.0,
        channels: (0..id).map(channel).collect(),
    });
    let plates = [1, 2].map(|id| ForcePlate { id, rate_hz: 1000.0, corners_mm: None });
    let served = ServedSettings { analog: analog.to_vec(), plates: plates.to_vec(), ..served() };
    for minor in [8, 10, 11, 28] {
        let xml = served.to_xml(minor, sampled).unwrap();
        let settings = Settings::parse(&xml).unwrap();
        assert_eq!(
            (&settings.analog[..], &settings.plates[..]),
            (&analog[..], &plates[..]),
            "{xml}"
        );
        let units = (settings.force_units.force.as_str(), settings.force_units.length.as_str());
        assert_eq!(units, ("N", "mm"));
    }
}

/// The example of the documents, and what is missing in it.
#[test]
fn analog_devices_without_labels_have_channels() {
    let xml = "<Q><The_6D><Bodies>2</Bodies><Body/><Body/></The_6D>\
               <Analog><Device><Device_ID>7</Device_ID><Channels>2</Channels><Frequency>2400</Frequency>\
               <Channel><Label>Channel 1</Label><Unit>volts</Unit></Channel></Device>\
               <Device><Channels>8</Channels></Device></Analog>\
               <Force><Plate/><Plate><Plate_ID>1</Plate_ID><Frequency>1000</Frequency></Plate></Force></Q>";
    let settings = Settings::parse(xml).unwrap();
    let pair = |label: &str, unit: &str| (label.to_owned(), unit.to_owned());
    let channels = vec![pair("Channel 1", "volts"), pair("analog 7.2", "")];
    assert_eq!(settings.bodies, Some(vec![BodySettings::default(); 2]));
    assert_eq!(settings.analog, [AnalogDevice { id: 7, rate_hz: 2400.0, channels }]);
    assert_eq!(settings.plates, [ForcePlate { id: 1, rate_hz: 1000.0, corners_mm: None }]);
    assert_eq!(settings.labels, None);
}

#[test]
fn hostile_documents_are_refused() {
    let deep = "<a>".repeat(100_000);
    let wide = format!("<a>{}</a>", "<b/>".repeat(300_000));
    let entities = "<!DOCTYPE a [<!ENTITY b \"bbbbbbbb\">]><a>&b;</a>".to_owned();
    let labels = format!(
        "<a><The_3D><Labels>{n}</Labels>{}</The_3D></a>",
        "<Label/>".repeat(LABELS_MAX + 1),
        n = LABELS_MAX + 1
    );
    let lie = "<a><The_3D><Labels>18446744073709551615</Labels></The_3D></a>".to_owned();
    // What a parser compares with one another: attributes of one element, and namespaces of its ancestors.
    let attributes: String = (0..400_000).map(|k| format!(" a{k}=\"\"")).collect();
    let attributes = format!("<a{attributes}/>");
    let namespaces: String = (0..60_000).map(|k| format!("<a xmlns:n{k}=\"{k}\">")).collect();
    let began = Instant::now();
    for xml in
        [deep, wide, entities, labels, lie, attributes, namespaces, String::new(), "\0".repeat(99)]
    {
        let problem = Settings::parse(&xml).unwrap_err();
        assert!(!problem.contains('\n') && problem.len() < 200, "{problem}");
    }
    // As many attributes as are read, in one element.
    let most: String = (0..1024).map(|k| format!(" a{k}=\"\"")).collect();
    let most = format!("<a{most}/>").repeat(60);
    assert!(Settings::parse(&format!("<a>{most}</a>")).is_ok());
    assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
}
