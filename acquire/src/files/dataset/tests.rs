use std::fs;

use super::*;
use crate::threads;

fn labels(subject: &str, run: Option<&str>) -> BidsLabels {
    BidsLabels::new(subject, None, "walk", run).unwrap()
}

/// Files that a recording can have: not those of all groups, which are more than a process may have open.
fn paths(labels: &BidsLabels) -> impl Iterator<Item = String> {
    labels.paths().take(74)
}

/// Writes the files of a recording, and those of a new data set.
fn recording(dataset: &Path, labels: &BidsLabels) -> anyhow::Result<NewRecording> {
    let mut staged_addition = NewRecording::begin(dataset, labels)?;
    for (path, content) in [
        (DESCRIPTION, "{\"BIDSVersion\": \"1.10.0\"}".to_owned()),
        ("README.md", "new".to_owned()),
        (PARTICIPANTS, format!("participant_id\nsub-{}\n", labels.subject())),
        ("participants.json", "{}".to_owned()),
    ] {
        staged_addition.common_file(path)?.write_all(content.as_bytes())?;
    }
    for path in paths(labels) {
        staged_addition.file(&path)?.write_all(path.as_bytes())?;
    }
    Ok(staged_addition)
}

fn add(dataset: &Path, labels: &BidsLabels) -> anyhow::Result<()> {
    recording(dataset, labels)?.keep()
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn participants(dataset: &Path) -> String {
    fs::read_to_string(dataset.join(PARTICIPANTS)).unwrap()
}

#[test]
fn a_data_set_appears_whole_or_not_at_all() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("set");
    drop(recording(&dataset, &labels("01", None)).unwrap());
    assert_eq!(names(dir.path()), [""; 0]);
    let mut staged_addition = recording(&dataset, &labels("01", None)).unwrap();
    assert!(
        staged_addition.file("sub-01/motion/sub-01_task-walk_tracksys-optical_motion.tsv").is_err()
    );
    // While it is written nothing can be seen, so nothing is left of a killed program.
    assert_eq!(names(dir.path()), [""; 0]);
    staged_addition.keep().unwrap();
    assert_eq!(names(dir.path()), ["set"]);
    assert_eq!(
        names(&dataset),
        ["README.md", DESCRIPTION, "participants.json", PARTICIPANTS, "sub-01"]
    );
    assert_eq!(names(&dataset.join("sub-01/motion")).len(), paths(&labels("01", None)).count());
    for path in paths(&labels("01", None)) {
        assert_eq!(fs::read_to_string(dataset.join(&path)).unwrap(), path);
    }
}

#[test]
fn recordings_are_added_and_the_data_set_keeps_its_files() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("set");
    add(&dataset, &labels("01", None)).unwrap();
    let description = "{\"BIDSVersion\": \"1.6.0\", \"Name\": \"mine\"}";
    fs::write(dataset.join(DESCRIPTION), description).unwrap();
    fs::write(dataset.join("README.md"), "mine").unwrap();
    fs::write(dataset.join(PARTICIPANTS), "participant_id\tage\nsub-01\t40\n").unwrap();
    let staged_addition = recording(&dataset, &labels("02", None)).unwrap();
    assert_eq!(names(&dataset).len(), 5, "nothing can be seen of it");
    staged_addition.keep().unwrap();
    add(&dataset, &labels("02", Some("2"))).unwrap();
    assert_eq!(participants(&dataset), "participant_id\tage\nsub-01\t40\nsub-02\tn/a\n");
    assert_eq!(fs::read_to_string(dataset.join(DESCRIPTION)).unwrap(), description);
    assert_eq!(fs::read_to_string(dataset.join("README.md")).unwrap(), "mine");
    let n_files = paths(&labels("01", None)).count();
    assert_eq!(names(&dataset.join("sub-02/motion")).len(), 2 * n_files);
    assert_eq!(names(&dataset).len(), 6);
    // A data set of another program, without a table of its own.
    fs::remove_file(dataset.join(PARTICIPANTS)).unwrap();
    fs::remove_file(dataset.join("participants.json")).unwrap();
    add(&dataset, &labels("03", None)).unwrap();
    assert_eq!(participants(&dataset), "participant_id\nsub-03\n");
    assert!(dataset.join("participants.json").exists());
}

#[test]
fn existing_recordings_are_refused_and_kept() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("set");
    add(&dataset, &labels("01", None)).unwrap();
    let late = recording(&dataset, &labels("02", None)).unwrap();
    let exists = |error: anyhow::Error| {
        assert!(error.to_string().contains("--run"), "{error}");
        matches!(error.downcast_ref(), Some(DatasetError::Exists(_)))
    };
    assert!(exists(add(&dataset, &labels("01", None)).unwrap_err()));
    // One of its files appears while it is written.
    let events =
        dataset.join(paths(&labels("02", None)).find(|path| path.contains("events")).unwrap());
    fs::create_dir_all(events.parent().unwrap()).unwrap();
    fs::write(&events, "mine").unwrap();
    assert!(exists(late.keep().unwrap_err()));
    assert_eq!(names(events.parent().unwrap()).len(), 1);
    assert_eq!(fs::read_to_string(events).unwrap(), "mine");
    assert_eq!(participants(&dataset), "participant_id\nsub-01\n");
}

#[test]
fn other_folders_are_not_data_sets() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("folder");
    fs::create_dir(&folder).unwrap();
    let refused = |path: &Path| {
        let error = recording(path, &labels("01", None)).unwrap_err();
        assert!(matches!(error.downcast_ref(), Some(DatasetError::NotADataset { .. })), "{error}");
    };
    refused(&folder);
    fs::write(folder.join(DESCRIPTION), "{}").unwrap();
    refused(&folder);
    refused(&folder.join(DESCRIPTION));
    fs::write(folder.join(DESCRIPTION), "{\"BIDSVersion\": \"1.8.0\"}").unwrap();
    add(&folder, &labels("01", None)).unwrap();
    let nowhere = dir.path().join("none/set");
    assert!(recording(&nowhere, &labels("01", None)).is_err());
}

#[test]
fn concurrent_exports_share_a_new_data_set() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("set");
    let subjects: Vec<String> = (10..26).map(|number| number.to_string()).collect();
    let adders: Vec<_> = subjects
        .iter()
        .map(|subject| {
            let (dataset, labels) = (dataset.clone(), labels(subject, None));
            threads::spawn("test-export", move || add(&dataset, &labels)).unwrap()
        })
        .collect();
    for adder in adders {
        adder.join().unwrap().unwrap();
    }
    assert_eq!(names(dir.path()), ["set"]);
    let mut rows: Vec<String> = participants(&dataset).lines().skip(1).map(str::to_owned).collect();
    rows.sort();
    let wanted: Vec<String> = subjects.iter().map(|subject| format!("sub-{subject}")).collect();
    assert_eq!(rows, wanted);
    for subject in subjects {
        let n_files = paths(&labels(&subject, None)).count();
        assert_eq!(names(&dataset.join(format!("sub-{subject}/motion"))).len(), n_files);
    }
    assert_eq!(names(&dataset).len(), 4 + 16, "no hidden folders");
}
