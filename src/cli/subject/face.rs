//! `subject face`: wireframes fitted to the faces of a photograph.

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

use super::MethodArg;
use crate::cli::{
    motion_files::{file_name, write_new},
    output::{eprint, notify, print, print_json_text},
    paths, plot,
    values::count,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The photograph: .png, .jpg or .pnm
    photo: PathBuf,
    /// The face to write, as JSON; further faces get -2, -3 … before the extension. No such file may exist. With - one
    /// line per face goes to standard output, and the table to standard error
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The wireframe to write, as OBJ; further faces are numbered in the same way
    #[arg(long, value_name = "FILE")]
    obj: Option<PathBuf>,
    /// Write a copy of the photograph to this file, .png, with points and wireframes drawn on it, and numbers if there
    /// are several faces; it must not exist
    #[arg(long, value_name = "FILE")]
    overlay: Option<PathBuf>,
    /// Write three views of the first wireframe to this file, .svg or .png; it must not exist
    #[arg(long, value_name = "FILE")]
    views: Option<PathBuf>,
    /// Method to find faces and locate their points: that of mocapd, or that of the paper (Yang et al. 2004)
    #[arg(long, value_enum, default_value_t = MethodArg::Default)]
    method: MethodArg,
    /// Use only the largest face
    #[arg(long)]
    largest: bool,
    /// Print the faces as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let to_stdout = args.output.as_deref().is_some_and(paths::is_dash);
    let output = args.output.as_ref().filter(|_| !to_stdout);
    for path in [output, args.obj.as_ref(), args.overlay.as_ref()].into_iter().flatten() {
        paths::check_output(path)?;
    }
    args.views.as_deref().map(plot::check_output).transpose()?;
    if let Some(path) = &args.overlay
        && !paths::ends_in(path, "png")
    {
        bail!(UsageError(format!("{}: the overlay is a PNG: use .png", path.display())));
    }
    for (path, ending, instead) in [
        (args.output.as_ref(), "obj", "the face is JSON: use .json, or --obj for the wireframe"),
        (args.obj.as_ref(), "json", "the wireframe is OBJ: use .obj, or -o for the face"),
    ] {
        if let Some(path) = path.filter(|path| paths::ends_in(path, ending)) {
            return Err(UsageError(format!("{}: {instead}", path.display())).into());
        }
    }
    check_distinct_outputs(args)?;
    let photo_path = args.photo.display();
    let bytes = files::read_bounded(&args.photo, BYTES_MAX)?;
    let photo = Photo::from_bytes(&bytes).with_context(|| format!("cannot read {photo_path}"))?;
    for note in &photo.notes {
        notify(&format!("{photo_path}: {note}"));
    }
    let source = Source {
        name: file_name(&args.photo),
        sha256: photo.sha256.iter().map(|byte| format!("{byte:02x}")).collect(),
        width: Some(u32::try_from(photo.width())?),
        height: Some(u32::try_from(photo.height())?),
    };
    let method = match args.method {
        MethodArg::Default => Method::Default,
        MethodArg::Paper => Method::Paper,
    };
    let mut faces = match fit(&photo, &source, method) {
        Ok(faces) => faces,
        Err(error @ (NoFace::NotFound | NoFace::NotFitted(_))) => bail!("{photo_path}: {error}"),
        Err(error) => return Err(error.into()),
    };
    faces.sort_by(|a, b| b.outer_eyes_px().total_cmp(&a.outer_eyes_px()));
    if args.largest && faces.len() > 1 {
        notify(&format!("{photo_path}: {} ignored", count(faces.len() as u64 - 1, "smaller face")));
        faces.truncate(1);
    }
    // The first outputs were checked before the photograph was read. Either all files are written, or none.
    for number in 1..faces.len() {
        for path in [output, args.obj.as_ref()].into_iter().flatten() {
            paths::check_output(&numbered(path, number))?;
        }
    }
    write(args, output, &photo, &faces)?;
    for warning in warnings(&faces) {
        notify(&format!("{photo_path}: {warning}"));
    }
    if args.json || to_stdout {
        for face in &faces {
            print_json_text(&face.to_json()?)?;
        }
    }
    match (args.json, to_stdout) {
        (false, false) => print(&table(&faces))?,
        (false, true) => eprint(&table(&faces)),
        (true, _) => {}
    }
    Ok(Outcome::Done)
}

/// Checks that no two outputs are the same file.
fn check_distinct_outputs(args: &Args) -> anyhow::Result<()> {
    let outputs = [&args.output, &args.obj, &args.overlay, &args.views];
    let outputs: Vec<&PathBuf> = outputs.into_iter().flatten().collect();
    for (i, one) in outputs.iter().enumerate() {
        if outputs[..i].iter().any(|other| paths::are_one(one, other)) {
            bail!(UsageError(format!("{}: two options name the same file", one.display())));
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

/// Largest yaw without a warning, degrees: beyond it a face occludes so much of itself that the points were wrong in
/// two of three photographs (docs/subject-face.md).
const YAW_MAX_DEG: f64 = 35.0;

/// Warnings about faces that should be checked.
pub(super) fn warnings(faces: &[FittedFace]) -> Vec<String> {
    let mut warnings = Vec::new();
    for (number, face) in faces.iter().enumerate() {
        let number = number + 1;
        if face.is_unsure() {
            warnings.push(format!("face {number}: points may be wrong: check them with --overlay"));
        }
        let yaw_deg = face.pose_deg.map_or(0.0, |pose| pose.yaw.abs());
        if yaw_deg > YAW_MAX_DEG {
            warnings.push(format!(
                "face {number} is turned by {yaw_deg:.0} degrees: beyond {YAW_MAX_DEG:.0} its far side is unreliable"
            ));
        }
    }
    warnings
}

/// The table of faces.
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
            out += &format!("{:>4} points may be wrong: {note}\n", number + 1);
        }
    }
    out
}
