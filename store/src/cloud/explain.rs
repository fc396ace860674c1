//! What a client's error means, and what to do about it.

use std::error::Error as _;

use object_store::Error;

use crate::{ObjectUrl, StoreError, location::Scheme};

/// Longest text of a store in a message.
const DETAIL_CHARS_MAX: usize = 200;

/// How the crate begins the text of an answer with an error, before its status.
const NOT_SUCCESSFUL: &str = "Server returned non-2xx status code: ";

/// Where each kind of store looks for credentials.
fn remedy(url: &ObjectUrl) -> &'static str {
    match url.scheme() {
        Scheme::S3 => {
            "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (from a profile: `eval \"$(aws configure export-credentials --format env)\"`), or run on a machine with a role"
        }
        Scheme::Gcs => {
            "set GOOGLE_APPLICATION_CREDENTIALS to a key file, run `gcloud auth application-default login`, or run on a machine with a service account"
        }
        Scheme::Azure => {
            "set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY (or AZURE_STORAGE_SAS_TOKEN), or run on a machine with a managed identity"
        }
        Scheme::File | Scheme::Http => "this server needs none that mocapd could send",
    }
}

/// The error of a client, by what to do about it.
pub(super) fn explain(url: &ObjectUrl, error: &Error) -> StoreError {
    let name = url.to_string();
    let texts = texts(error);
    // The outer texts repeat the URL, which may contain any word.
    let mentions = |words: &[&str]| {
        let is_said = |w: &&str| !name.contains(*w) && texts.iter().any(|text| text.contains(*w));
        words.iter().any(is_said)
    };
    let answer = texts.last().map_or("", String::as_str);
    let code = element(answer, "Code").unwrap_or_default();
    let is_status = |status: &str| {
        answer.strip_prefix(NOT_SUCCESSFUL).is_some_and(|answer| answer.starts_with(status))
    };
    // Nothing answers there but in a cloud, whose machines have credentials.
    let metadata =
        ["169.254.169.254", "metadata.google.internal", "169.254.170.2", "/latest/api/token"];
    let missing = ["must be specified", "Missing access key", "Missing secret", "Account must"];
    match error {
        _ if matches!(code, "NoSuchBucket" | "ContainerNotFound") => StoreError::NoBucket(name),
        Error::NotFound { .. } => StoreError::NotFound(name),
        Error::AlreadyExists { .. } => StoreError::Exists(name),
        Error::Precondition { .. } | Error::NotModified { .. } => StoreError::Changed(name),
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            StoreError::Forbidden { url: name, detail: detail(&texts) }
        }
        Error::InvalidPath { .. } => StoreError::InvalidUrl { url: name, reason: detail(&texts) },
        Error::NotSupported { .. } | Error::NotImplemented { .. } => {
            StoreError::Unsupported { url: name, reason: detail(&texts) }
        }
        _ if is_status("416") || code == "InvalidRange" => {
            StoreError::Unsupported { url: name, reason: "it has no such range".to_owned() }
        }
        _ if mentions(&metadata) || mentions(&missing) => {
            StoreError::NoCredentials { url: name, remedy: remedy(url) }
        }
        _ if mentions(&["timed out", "TimedOut", "deadline has elapsed"]) => {
            StoreError::TimedOut(name)
        }
        _ => StoreError::Unavailable { url: name, detail: detail(&texts) },
    }
}

/// The texts of an error and its sources.
fn texts(error: &Error) -> Vec<String> {
    let mut texts = vec![error.to_string()];
    let mut source = error.source();
    while let Some(error) = source {
        texts.push(error.to_string());
        source = error.source();
    }
    texts
}

/// The text of an element of a store's answer.
fn element<'a>(answer: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = answer.split_once(&format!("<{name}>"))?;
    Some(rest.split_once(&format!("</{name}>"))?.0)
}

/// What the store said, in one line: the message in its answer, or else the innermost error.
fn detail(texts: &[String]) -> String {
    let of_xml = texts.iter().find_map(|text| element(text, "Message"));
    let text = of_xml.or_else(|| texts.last().map(String::as_str)).unwrap_or_default();
    // A status that came without a text is followed by a colon and nothing.
    let text = text.trim_start_matches(NOT_SUCCESSFUL).trim_end_matches([':', ' ', '\n']);
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ").chars().take(DETAIL_CHARS_MAX).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The texts are those of the crate, which states most causes in words only.
    #[test]
    fn errors_say_what_to_do() {
        let url = ObjectUrl::parse("s3://lab/x.take").unwrap();
        let name = || url.to_string();
        let generic = |text: &str| Error::Generic { store: "S3", source: text.into() };
        let not_found = |text: &str| Error::NotFound { path: "x".to_owned(), source: text.into() };
        let denied = "status 403: <Error><Code>AccessDenied</Code><Message>Access\n Denied</Message></Error>";
        let denied = Error::PermissionDenied { path: "x".to_owned(), source: denied.into() };
        for (error, expected) in [
            (not_found("status 404"), StoreError::NotFound(name())),
            (not_found("<Code>NoSuchBucket</Code>"), StoreError::NoBucket(name())),
            (denied, StoreError::Forbidden { url: name(), detail: "Access Denied".to_owned() }),
            (
                generic("Error performing PUT http://169.254.169.254/latest/api/token"),
                StoreError::NoCredentials { url: name(), remedy: remedy(&url) },
            ),
            (generic("operation timed out"), StoreError::TimedOut(name())),
            (
                generic("status 503, after 3 retries, retry_timeout: 30s"),
                StoreError::Unavailable {
                    url: name(),
                    detail: "status 503, after 3 retries, retry_timeout: 30s".to_owned(),
                },
            ),
            (
                generic("Server returned non-2xx status code: 503 Service Unavailable: "),
                StoreError::Unavailable {
                    url: name(),
                    detail: "503 Service Unavailable".to_owned(),
                },
            ),
            (
                generic("connection refused"),
                StoreError::Unavailable { url: name(), detail: "connection refused".to_owned() },
            ),
        ] {
            assert_eq!(explain(&url, &error), expected);
        }
    }

    #[test]
    fn words_of_the_url_are_no_cause() {
        let url = "s3://lab/416/timed out/NoSuchBucket/169.254.169.254/InvalidRange.take";
        let url = ObjectUrl::parse(url).unwrap();
        for (status, expected) in [
            ("500 Internal Server Error: ", None),
            ("416 Range Not Satisfiable: ", Some("it has no such range")),
            ("400 Bad Request: <Code>InvalidRange</Code>", Some("it has no such range")),
            ("500 Oops: <Code>InternalError</Code><Key>416/NoSuchBucket</Key>", None),
        ] {
            let text = format!("{NOT_SUCCESSFUL}{status}");
            let outer = format!("Error performing GET http://h/{} in 1s - {text}", url.key());
            let error = Error::Generic { store: "S3", source: Box::new(Outer(outer, text.into())) };
            match (explain(&url, &error), expected) {
                (StoreError::Unsupported { reason, .. }, Some(expected)) => {
                    assert_eq!(reason, expected);
                }
                (StoreError::Unavailable { .. }, None) => {}
                (other, _) => panic!("{status}: {other:?}"),
            }
        }
    }

    /// An error with a source, as the crate's.
    #[derive(Debug)]
    struct Outer(String, Box<dyn std::error::Error + Send + Sync>);

    impl std::fmt::Display for Outer {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str(&self.0)
        }
    }

    impl std::error::Error for Outer {
        fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
            Some(&*self.1)
        }
    }
}
