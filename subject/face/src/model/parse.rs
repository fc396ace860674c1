//! The text format of models.

use std::collections::BTreeMap;
use std::str::{FromStr, SplitAsciiWhitespace};

use thiserror::Error;

use super::{Anchor, FeatureId, Kind, Mode, Model};
use crate::shortened;

/// Far above any wireframe that is worth drawing; what the arithmetic of a fit costs grows with it.
const MAX_VERTICES: usize = 20_000;
const MAX_MODES: usize = 200;
const STORED_UNITS_PER_MM: f64 = 100.0;

/// Why a text is no model.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("line {line} of the face model: {what}")]
pub struct ModelError {
    /// From 1.
    pub line: usize,
    /// What was expected, and what is there.
    pub what: String,
}

struct Lines<'a> {
    rest: std::iter::Enumerate<std::str::Lines<'a>>,
    line: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Result<Words<'a>, ModelError> {
        for (number, line) in self.rest.by_ref() {
            self.line = number + 1;
            if !line.starts_with('#') && !line.trim().is_empty() {
                return Ok(Words { words: line.split_ascii_whitespace(), line: self.line });
            }
        }
        Err(ModelError { line: self.line, what: "the text ends too early".into() })
    }

    /// `word count`, as each part begins.
    fn section(&mut self, word: &str, most: usize) -> Result<usize, ModelError> {
        let mut words = self.next()?;
        let found = words.text(word)?;
        if found != word {
            return Err(words.wrong(format!("expected {word}, found {found:?}")));
        }
        let count = words.number(word)?;
        if count > most {
            return Err(words.wrong(format!("{count} {word}, where {most} is the most")));
        }
        words.end()?;
        Ok(count)
    }
}

struct Words<'a> {
    words: SplitAsciiWhitespace<'a>,
    line: usize,
}

impl<'a> Words<'a> {
    fn wrong(&self, what: impl Into<String>) -> ModelError {
        ModelError { line: self.line, what: shortened(&what.into()) }
    }

    fn text(&mut self, what: &str) -> Result<&'a str, ModelError> {
        self.words.next().ok_or_else(|| self.wrong(format!("{what} is missing")))
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T, ModelError> {
        let word = self.text(what)?;
        word.parse().map_err(|_| self.wrong(format!("{what} is {word:?}, which is no number")))
    }

    fn index(&mut self, count: usize) -> Result<usize, ModelError> {
        let index = self.number("a vertex")?;
        if index >= count {
            return Err(self.wrong(format!("vertex {index}, where there are {count}")));
        }
        Ok(index)
    }

    fn point(&mut self) -> Result<[f64; 3], ModelError> {
        let mut point = [0.0; 3];
        for axis in &mut point {
            *axis = f64::from(self.number::<i32>("a coordinate")?) / STORED_UNITS_PER_MM;
        }
        Ok(point)
    }

    fn end(mut self) -> Result<(), ModelError> {
        match self.words.next() {
            None => Ok(()),
            Some(word) => Err(self.wrong(format!("{word:?} is one word too many"))),
        }
    }
}

/// Reads what `subject/face/data/build/face_model.py` writes.
pub(super) fn model(text: &str) -> Result<Model, ModelError> {
    let mut lines = Lines { rest: text.lines().enumerate(), line: 0 };
    if lines.section("face-model", usize::MAX)? != 1 {
        let what = "a format that this version does not know; format 1 is the one it knows";
        return Err(ModelError { line: lines.line, what: what.into() });
    }
    let count = lines.section("vertices", MAX_VERTICES)?;
    let vertices = collect(count, || {
        let mut words = lines.next()?;
        let point = words.point()?;
        words.end().map(|()| point)
    })?;
    let triangles = triangles(&mut lines, count)?;
    let features = features(&mut lines, count)?;
    let mut fixed = Vec::new();
    for id in FeatureId::all().skip(FeatureId::CONTOUR) {
        let missing = || ModelError { line: lines.line, what: format!("no feature {}", id.name()) };
        fixed.push(*features.get(id.name()).ok_or_else(missing)?);
    }
    let contours = contours(&mut lines, count)?;
    let modes = modes(&mut lines, count)?;
    Ok(Model { vertices, triangles, features, modes, contours, fixed })
}

/// `count` items, without room being made for more than there turn out to be.
fn collect<T>(
    count: usize,
    mut item: impl FnMut() -> Result<T, ModelError>,
) -> Result<Vec<T>, ModelError> {
    (0..count).map(|_| item()).collect()
}

fn triangles(lines: &mut Lines<'_>, count: usize) -> Result<Vec<[usize; 3]>, ModelError> {
    let number = lines.section("triangles", 2 * MAX_VERTICES)?;
    collect(number, || {
        let mut words = lines.next()?;
        let triangle = [words.index(count)?, words.index(count)?, words.index(count)?];
        words.end().map(|()| triangle)
    })
}

fn features(lines: &mut Lines<'_>, count: usize) -> Result<BTreeMap<String, usize>, ModelError> {
    let mut features = BTreeMap::new();
    for _ in 0..lines.section("features", MAX_VERTICES)? {
        let mut words = lines.next()?;
        let name = words.text("a name")?.to_owned();
        let vertex = words.index(count)?;
        if features.insert(name, vertex).is_some() {
            return Err(words.wrong("the same name twice"));
        }
        words.end()?;
    }
    Ok(features)
}

/// The rows in the order of the points that they are for.
fn contours(lines: &mut Lines<'_>, count: usize) -> Result<Vec<Vec<Anchor>>, ModelError> {
    let mut rows = vec![Vec::new(); FeatureId::CONTOUR];
    for _ in 0..lines.section("contours", FeatureId::CONTOUR)? {
        let mut words = lines.next()?;
        let name = words.text("a name")?;
        let id = FeatureId::from_name(name).filter(|id| id.is_contour());
        let id = id.ok_or_else(|| words.wrong(format!("{name:?} is no point of the outline")))?;
        let places = words.number("a number of places")?;
        rows[id.index()] = collect(places, || {
            let (from, to) = (words.index(count)?, words.index(count)?);
            let fraction = words.number::<f64>("a fraction")?;
            match (0.0..=1.0).contains(&fraction) {
                true => Ok(Anchor { from, to, fraction }),
                false => Err(words.wrong(format!("a fraction of {fraction}"))),
            }
        })?;
        words.end()?;
    }
    match rows.iter().position(Vec::is_empty) {
        None => Ok(rows),
        Some(row) => {
            let name = FeatureId::from_index(row).map_or("", FeatureId::name);
            Err(ModelError { line: lines.line, what: format!("no places for {name}") })
        }
    }
}

fn modes(lines: &mut Lines<'_>, count: usize) -> Result<Vec<Mode>, ModelError> {
    let number = lines.section("modes", MAX_MODES)?;
    collect(number, || {
        let mut words = lines.next()?;
        let kind = match words.text("a kind of mode")? {
            "identity" => Kind::Identity,
            "expression" => Kind::Expression,
            other => return Err(words.wrong(format!("{other:?} is no kind of mode"))),
        };
        let displacements = collect(count, || words.point())?;
        words.end().map(|()| Mode { kind, displacements })
    })
}
