//! Who is captured, as `record` and `import` are told.

use std::path::PathBuf;

use mocapd::outcome::UsageError;
use mocapd_service::subject::{NAME_BYTES_MAX, SubjectFiles};
use mocapd_take::record::Subject;

#[derive(Debug, Clone, clap::Args)]
pub(crate) struct SubjectArgs {
    /// What the subject is called; it stands in the take
    #[arg(long, value_name = "NAME")]
    subject: Option<String>,
    /// The subject's skeleton, which the take carries: a skeleton.json of `mocapd subject body`
    #[arg(long, value_name = "FILE")]
    skeleton: Option<PathBuf>,
    /// The subject's face, which the take carries: a face.json of `mocapd subject face`
    #[arg(long, value_name = "FILE")]
    face: Option<PathBuf>,
    /// Which marker sits where on the face: a mapping of labels to vertices
    #[arg(long, value_name = "FILE", requires = "face")]
    face_markers: Option<PathBuf>,
}

impl SubjectArgs {
    /// Reads and checks them.
    ///
    /// # Errors
    /// Which file is missing, too large, or is not what it should be; a usage error for a name that is too long.
    pub(crate) fn load(&self) -> anyhow::Result<Option<Subject>> {
        let Self { subject, skeleton, face, face_markers } = self.clone();
        if subject.as_ref().is_some_and(|name: &String| name.len() > NAME_BYTES_MAX) {
            let message = format!("--subject has more than {NAME_BYTES_MAX} bytes");
            return Err(UsageError(message).into());
        }
        SubjectFiles { name: subject, skeleton, face, face_markers }.load()
    }
}
