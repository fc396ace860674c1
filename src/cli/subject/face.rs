//! `subject face`.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::files;
use mocapd_face::{
    Photo,
    fit::{NoFace, fit},
    fitted::{FittedFace, Method, Overlay, Source},
    photo::BYTES_MAX,
    points::FAINT,
};

use super::Chosen;
use crate::cli::{
    output::{print, print_json_text, say, tell},
    paths, plot,
    values::count,
    whole::{name, write_new},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The photograph, .png, .jpg or .pnm
    photo: PathBuf,
    /// The face to write, as JSON; with several faces -2, -3 … before the ending; none may exist. - writes a line a face to
    /// standard output, and the table to standard error
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The wireframe to write, as OBJ; numbered likewise
    #[arg(long, value_name = "FILE")]
    obj: Option<PathBuf>,
    /// The photograph with points and wireframes drawn on it, .png, and numbers where there are several; it must not exist
    #[arg(long, value_name = "FILE")]
    overlay: Option<PathBuf>,
    /// The first wireframe from three sides, .svg or .png; it must not exist
    #[arg(long, value_name = "FILE")]
    views: Option<PathBuf>,
    /// How faces are found: ours, or as Yang et al. 2004 print it
    #[arg(long, value_enum, default_value_t = Chosen::Default)]
    method: Chosen,
    /// Take the largest face alone
    #[arg(long)]
    largest: bool,
    /// Print the faces as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let to_stdout = args.output.as_deref().is_some_and(paths::is_stdout);
    let output = args.output.as_ref().filter(|_| !to_stdout);
    for path in [output, args.obj.as_ref(), args.overlay.as_ref()].into_iter().flatten() {
        paths::check_output(path)?;
    }
    args.views.as_deref().map(plot::check_output).transpose()?;
    if let Some(path) = &args.overlay
        && !paths::ends_in(path, "png")
    {
        let message = format!("{}: an overlay is a PNG: use .png", path.display());
        return Err(UsageError(message).into());
    }
    for (path, ending, instead) in [
        (args.output.as_ref(), "obj", "the face is JSON: use .json, or --obj for the wireframe"),
        (args.obj.as_ref(), "json", "the wireframe is OBJ: use .obj, or -o for the face"),
    ] {
        if let Some(path) = path.filter(|path| paths::ends_in(path, ending)) {
            return Err(UsageError(format!("{}: {instead}", path.display())).into());
        }
    }
    apart(args)?;
    let shown = args.photo.display();
    let bytes = files::read_bounded(&args.photo, BYTES_MAX)?;
    let photo = Photo::from_bytes(&bytes).with_context(|| format!("cannot read {shown}"))?;
    for note in &photo.notes {
        say(&format!("{shown}: {note}"));
    }
    let source = Source {
        name: name(&args.photo),
        sha256: photo.sha256.iter().map(|byte| format!("{byte:02x}")).collect(),
        width: Some(u32::try_from(photo.width())?),
        height: Some(u32::try_from(photo.height())?),
    };
    let method = match args.method {
        Chosen::Default => Method::Default,
        Chosen::Paper => Method::Paper,
    };
    let mut faces = match fit(&photo, &source, method) {
        Ok(faces) => faces,
        Err(error @ (NoFace::NotFound | NoFace::NotFitted(_))) => bail!("{shown}: {error}"),
        Err(error) => return Err(error.into()),
    };
    faces.sort_by(|a, b| b.outer_eyes_px().total_cmp(&a.outer_eyes_px()));
    if args.largest && faces.len() > 1 {
        say(&format!("{shown}: {} left out", count(faces.len() as u64 - 1, "smaller face")));
        faces.truncate(1);
    }
    // The first were known before the photograph was read: all of them, or none is written.
    for number in 1..faces.len() {
        for path in [output, args.obj.as_ref()].into_iter().flatten() {
            paths::check_output(&numbered(path, number))?;
        }
    }
    write(args, output, &photo, &faces)?;
    for words in doubts(&faces) {
        say(&format!("{shown}: {words}"));
    }
    if args.json || to_stdout {
        for face in &faces {
            print_json_text(&face.to_json()?)?;
        }
    }
    match (args.json, to_stdout) {
        (false, false) => print(&table(&faces))?,
        (false, true) => tell(&table(&faces)),
        (true, _) => {}
    }
    Ok(Outcome::Done)
}

/// That no two outputs are one file.
fn apart(args: &Args) -> anyhow::Result<()> {
    let outputs = [&args.output, &args.obj, &args.overlay, &args.views];
    let outputs: Vec<&PathBuf> = outputs.into_iter().flatten().collect();
    for (i, one) in outputs.iter().enumerate() {
        if outputs[..i].iter().any(|other| paths::are_one(one, other)) {
            let message = format!("{}: two outputs would be one file", one.display());
            return Err(UsageError(message).into());
        }
    }
    Ok(())
}

fn write(
    args: &Args,
    output: Option<&PathBuf>,
    photo: &Photo,
    faces: &[FittedFace],
) -> anyhow::Result<()> {
    for (number, face) in faces.iter().enumerate() {
        if let Some(path) = output {
            write_new(&numbered(path, number), face.to_json()?.as_bytes())?;
        }
        if let Some(path) = &args.obj {
            write_new(&numbered(path, number), face.to_obj().as_bytes())?;
        }
    }
    if let Some(path) = &args.overlay {
        let png = Overlay::png(photo, faces)
            .map_err(|error| anyhow!("cannot draw {}: {error}", path.display()))?;
        write_new(path, &png)?;
    }
    if let (Some(path), Some(face)) = (&args.views, faces.first()) {
        plot::write(path, &face.to_svg())?;
    }
    Ok(())
}

/// `face.json`, `face-2.json`, and so on.
fn numbered(path: &Path, number: usize) -> PathBuf {
    if number == 0 {
        return path.to_owned();
    }
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{}", number + 1));
    if let Some(ending) = path.extension() {
        name.push(".");
        name.push(ending);
    }
    path.with_file_name(name)
}

/// Beyond this a face hides so much of itself that the points of two photographs of three were off (docs/subject-face.md).
const YAW_SEEN_DEG: f64 = 35.0;

/// What is to be looked at.
pub(super) fn doubts(faces: &[FittedFace]) -> Vec<String> {
    let mut words = Vec::new();
    for (number, face) in faces.iter().enumerate() {
        let number = number + 1;
        if face.is_unsure() {
            words.push(format!("face {number}: points may be off: look at the overlay"));
        }
        let yaw_deg = face.pose_deg.map_or(0.0, |pose| pose.yaw.abs());
        if yaw_deg > YAW_SEEN_DEG {
            words.push(format!(
                "face {number} is turned by {yaw_deg:.0} degrees: beyond {YAW_SEEN_DEG:.0} its far side is a guess"
            ));
        }
    }
    words
}

/// What people read.
pub(super) fn table(faces: &[FittedFace]) -> String {
    let mut out = format!("{}\n", count(faces.len() as u64, "face"));
    out += "face     at x, y px   eye corners px   yaw deg   pitch deg   roll deg   points seen   confidence\n";
    for (number, face) in faces.iter().enumerate() {
        let Some(camera) = face.camera() else { continue };
        let seen = face.points.iter().filter(|point| point.confidence > FAINT).count();
        out += &format!(
            "{:>4} {:>14} {:>16.0} {:>9.1} {:>11.1} {:>10.1} {:>7} of 53 {:>12}\n",
            number + 1,
            format!("{:.0}, {:.0}", camera.origin_px[0], camera.origin_px[1]),
            face.outer_eyes_px(),
            camera.yaw_deg,
            camera.pitch_deg,
            camera.roll_deg,
            seen,
            face.confidence.map_or("-".to_owned(), |sure| format!("{sure:.2}"))
        );
    }
    for (number, face) in faces.iter().enumerate() {
        for note in &face.notes {
            out += &format!("{:>4} points may be off: {note}\n", number + 1);
        }
    }
    out
}
