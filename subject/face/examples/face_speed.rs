//! Computation time of the steps of a fit: `cargo run --release -p mocapd-face --features measure --example face_speed`.
//!
//! CPU time, the minimum of many rounds: other work on the machine only ever adds time.

use std::convert::Infallible;
use std::error::Error;
use std::time::Duration;

use mocapd_face::Photo;
use mocapd_face::adapt::{Depth, Width, adapt};
use mocapd_face::find;
use mocapd_face::model::{FeatureId, FitOptions, Landmark, Model};
use mocapd_face::points::{self, RoughFace};
use mocapd_testkit::photograph::Scene;
use rustix::time::{ClockId, clock_gettime};

const ROUNDS: usize = 300;
const FIND_ROUNDS: usize = 30;
/// Sides of a photograph of a quarter of a megapixel.
const QUARTER_PX: (u32, u32) = (560, 448);

/// CPU time of this thread.
fn spent() -> Duration {
    let spent = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(spent.tv_sec.unsigned_abs(), spent.tv_nsec as u32)
}

fn fastest<T, E>(rounds: usize, mut work: impl FnMut() -> Result<T, E>) -> Result<Duration, E> {
    let mut best = Duration::MAX;
    for _ in 0..rounds {
        let begin = spent();
        let result = std::hint::black_box(work()?);
        best = best.min(spent().saturating_sub(begin));
        drop(result);
    }
    Ok(best)
}

#[expect(clippy::print_stdout, reason = "an example prints")]
fn main() -> Result<(), Box<dyn Error>> {
    let model = Model::generic()?;
    let picture = Scene::portrait(3, 80.0, 20.0).render()?;
    let Some(truth) = picture.faces.first() else {
        return Err("the scene has no face".into());
    };
    let points: Vec<_> =
        FeatureId::all().map(|id| Landmark { id, xy_px: truth.at(id), confidence: 1.0 }).collect();
    let options = FitOptions::default();
    let fit = model.fit_shape(&points, &options)?;
    let depths: Vec<_> = fit.points_px.iter().map(|p| p[2]).collect();
    println!(
        "{} vertices, {} points, {} modes",
        model.vertices.len(),
        points.len(),
        model.modes.len()
    );
    println!(
        "fit of pose and shape    {:?}",
        fastest(ROUNDS, || model.fit_shape(&points, &options))?
    );
    let carry = |width, depth| adapt(model, &fit.vertices_mm, &fit.camera, &points, width, depth);
    println!(
        "adaptation, as printed   {:?}",
        fastest(ROUNDS, || carry(Width::PAPER, Depth::Model))?
    );
    println!(
        "adaptation, default      {:?}",
        fastest(ROUNDS, || carry(Width::default(), Depth::Model))?
    );
    println!(
        "adaptation, with depths  {:?}",
        fastest(ROUNDS, || carry(Width::default(), Depth::Points(&depths)))?
    );
    let mut scene = Scene::portrait(3, 80.0, 20.0);
    (scene.width_px, scene.height_px) = QUARTER_PX;
    let image = scene.render()?.image;
    let pixels = image.pixels().map(|pixel| pixel.0).collect();
    let photo = Photo::from_pixels(image.width() as usize, image.height() as usize, pixels)?;
    let find = || Ok::<_, Infallible>(find::faces(&photo, find::SCORE_MIN));
    println!("finding on 0.25 megapixel {:?}", fastest(FIND_ROUNDS, find)?);
    let chain = || {
        let found = find::faces(&photo, find::SCORE_MIN);
        found
            .iter()
            .map(|face| points::find(&photo, &RoughFace::from(face)))
            .collect::<Result<Vec<_>, _>>()
    };
    println!("and the points of its {} {:?}", chain()?.len(), fastest(FIND_ROUNDS, chain)?);
    Ok(())
}
