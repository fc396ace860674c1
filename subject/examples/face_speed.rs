//! How long the arithmetic of a face takes: `cargo run --release -p mocapd-subject --example face_speed`.
//!
//! Of many rounds the fastest counts: what else the machine does only ever adds.

use std::error::Error;
use std::time::{Duration, Instant};

use mocapd_subject::face::adapt::{Depth, Settings, adapt};
use mocapd_subject::face::model::{FeatureId, FitOptions, Model};
use mocapd_subject::face::render::Scene;

const ROUNDS: usize = 300;

fn fastest<T, E>(mut work: impl FnMut() -> Result<T, E>) -> Result<Duration, E> {
    let mut best = Duration::MAX;
    for _ in 0..ROUNDS {
        let begin = Instant::now();
        let result = std::hint::black_box(work()?);
        best = best.min(begin.elapsed());
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
    let weighted: Vec<_> = FeatureId::all().map(|id| (id, truth.at(id), 1.0)).collect();
    let points: Vec<_> = FeatureId::all().map(|id| (id, truth.at(id))).collect();
    let options = FitOptions::default();
    let fit = model.fit_shape(&weighted, &options)?;
    let depths: Vec<_> = fit.points_px.iter().map(|p| p[2]).collect();
    println!(
        "{} vertices, {} points, {} modes",
        model.vertices.len(),
        points.len(),
        model.modes.len()
    );
    println!("fit of pose and shape    {:?}", fastest(|| model.fit_shape(&weighted, &options))?);
    let carry =
        |settings, depth| adapt(model, &fit.vertices_mm, &fit.camera, &points, settings, depth);
    println!("adaptation, as printed   {:?}", fastest(|| carry(Settings::PAPER, Depth::Model))?);
    println!(
        "adaptation, default      {:?}",
        fastest(|| carry(Settings::default(), Depth::Model))?
    );
    println!(
        "adaptation, with depths  {:?}",
        fastest(|| carry(Settings::default(), Depth::Points(&depths)))?
    );
    Ok(())
}
