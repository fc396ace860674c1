//! Meshes with known joints: OBJ files, each with a JSON file of the same name.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use mocapd_body::Mesh;
use serde::Deserialize;

/// The ground truth of a mesh.
#[derive(Debug, Deserialize)]
pub(crate) struct Truth {
    pub(crate) name: String,
    pub(crate) stature_m: f64,
    pub(crate) joints: Option<BTreeMap<String, [f64; 3]>>,
}

/// All meshes below `folder`, sorted by name.
pub(crate) fn all(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            found.extend(all(&path)?);
        } else if path.extension().is_some_and(|end| end == "obj") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// The mesh at `path`, and the ground truth in the JSON file of the same name.
pub(crate) fn body(path: &Path) -> Result<(Mesh, Truth), Box<dyn std::error::Error>> {
    let truth = serde_json::from_str(&fs::read_to_string(path.with_extension("json"))?)?;
    let mut mesh = Mesh::default();
    for line in fs::read_to_string(path)?.lines() {
        let mut tokens = line.split_whitespace();
        let kind = tokens.next();
        if kind == Some("v") {
            let mut next = || tokens.next().unwrap_or_default().parse::<f64>();
            mesh.positions.push([next()?, next()?, next()?]);
        } else if kind == Some("f") {
            let corners =
                tokens.map(|token| token.split('/').next().unwrap_or_default().parse::<u32>());
            let corners = corners.collect::<Result<Vec<_>, _>>()?;
            for at in 2..corners.len() {
                mesh.triangles.push([corners[0] - 1, corners[at - 1] - 1, corners[at] - 1]);
            }
        }
    }
    Ok((mesh, truth))
}
