//! The invariants of ARCHITECTURE.md that can be seen in the text of the source.

use std::path::{Path, PathBuf};

/// What must not be said, and where it may be.
struct Rule {
    /// The invariant, as a failure tells it.
    says: &'static str,
    words: &'static [&'static str],
    /// Files, folders (with `/` at the end), or beginnings of either, where the words may stand.
    allowed: &'static [&'static str],
}

const RULES: &[Rule] = &[
    Rule {
        says: "the simulator is for the demo and the benches: nothing else of the daemon knows it",
        words: &["mocapd_simulator"],
        allowed: &["src/cli/demo", "src/cli/bench", "simulator/src/"],
    },
    Rule {
        says: "every thread has a name, and acquire and the service start threads, but for the one of `mocapd-sim` that waits for signals",
        words: &["thread::Builder", "thread::{Builder", "thread::scope"],
        allowed: &[
            "acquire/src/threads.rs",
            "acquire/src/pipeline/offline.rs",
            "simulator/src/cli/serve/stop.rs",
        ],
    },
    Rule {
        says: "a thread without a name is a thread nobody finds: use threads::spawn",
        words: &["thread::spawn("],
        allowed: &[],
    },
    Rule {
        says: "clocks are read in acquire, in src/, on the simulated line, and where a transport waits",
        words: &[
            "Instant::now",
            "SystemTime::now",
            "clock_gettime",
            "Timestamp::now",
            "thread::sleep",
        ],
        allowed: &[
            "acquire/src/",
            "service/src/",
            "src/",
            "simulator/src/line/",
            "simulator/src/gadget/",
            "simulator/src/cli/serve/stop.rs",
            "drivers/src/transport/",
        ],
    },
    Rule {
        says: "libraries do not print: stdout is data and stderr is words, and the command lines say both",
        words: &["println!", "print!(", "eprintln!", "eprint!(", "io::stdout", "io::stderr"],
        allowed: &["src/cli/", "simulator/src/main.rs", "simulator/src/cli/"],
    },
    Rule {
        says: "main.rs ends the process, and nobody else",
        words: &["process::exit", "process::abort", "ExitCode"],
        allowed: &["src/main.rs", "src/outcome.rs", "simulator/src/main.rs"],
    },
    Rule {
        says: "nothing on the sample path waits for a lock",
        words: &["Mutex", "RwLock", "Condvar"],
        // The log's rate limit and the queue of triggers are used by threads that may wait. The service waits for the data
        // plane, which meets it in one place: once a stretch, in the writer.
        allowed: &[
            "acquire/src/pipeline/progress.rs",
            "service/src/engine/",
            "service/src/http/",
            "service/src/log/rate_limit.rs",
            "service/src/trigger/queue.rs",
        ],
    },
    Rule {
        says: "every queue is bounded",
        words: &["unbounded(", "mpsc::channel", "VecDeque::new()"],
        allowed: &[],
    },
    Rule {
        says: "codec, take and the link protocol are sans-io: no files, no sockets, no devices",
        words: &["fs::", "{fs,", "net::", "env::"],
        // What is read whole is opened by one function, which the program and the simulator share.
        allowed: &[
            "acquire/src/",
            "service/src/",
            "src/",
            "drivers/src/plain_file.rs",
            "simulator/src/cli/",
            "simulator/src/pty/",
            "simulator/src/gadget/",
            "drivers/src/transport/",
        ],
    },
    Rule {
        says: "files are created in files.rs, and its folder, which never overwrite one; what the simulator writes is new, too",
        words: &["File::create", "File::create_new", "OpenOptions", "fs::write(", "fs::rename("],
        allowed: &[
            "acquire/src/files",
            "simulator/src/cli/serve/mod.rs",
            "simulator/src/cli/generate.rs",
        ],
    },
    Rule {
        says: "a crate that could be replaced is named in one room",
        words: &["ringbuf"],
        allowed: &["acquire/src/pipeline/ring.rs"],
    },
    Rule {
        says: "async lives in the HTTP API, and in the client that asks it",
        words: &["tokio::", "axum::", "hyper::", "async fn", "async move", ".await"],
        allowed: &["service/src/http/", "src/cli/ctl/"],
    },
    Rule {
        says: "bincode is for small records behind a checksum",
        words: &["bincode"],
        allowed: &["take/src/record/"],
    },
    Rule {
        says: "devices are opened by transports",
        words: &["serialport", "nusb"],
        allowed: &["drivers/src/transport/", "drivers/src/registry.rs"],
    },
    Rule {
        says: "a USB device is made in one room",
        words: &["usb_gadget::"],
        allowed: &["simulator/src/gadget/"],
    },
    Rule {
        says: "unsafe code is for two system calls that no safe crate wraps, and for one function of more \
               CPU features than the crate's",
        words: &["unsafe {", "unsafe fn", "unsafe impl"],
        allowed: &["codec/src/coding/isa.rs", "drivers/src/transport/tty.rs"],
    },
];

/// The sources of the workspace: the Python package is another one.
fn product_sources() -> Vec<PathBuf> {
    let sources = super::product_sources(&super::root());
    sources.into_iter().filter(|path| !path.starts_with("python")).collect()
}

#[test]
fn the_source_keeps_the_invariants() {
    let sources: Vec<_> =
        product_sources().into_iter().map(|path| (super::text(&path), path)).collect();
    assert!(sources.len() > 100, "only {} sources were found", sources.len());
    let mut complaints = Vec::new();
    for rule in RULES {
        for (text, path) in &sources {
            complaints.extend(violations(rule, path, text));
        }
    }
    assert!(complaints.is_empty(), "ARCHITECTURE.md says otherwise:\n{}", complaints.join("\n"));
}

#[test]
fn no_exception_outlives_its_reason() {
    for rule in RULES {
        for &allowed in rule.allowed {
            let used = product_sources().iter().any(|path| {
                let here = Rule { allowed: &[], ..*rule };
                begins(path, allowed) && !violations(&here, path, &super::text(path)).is_empty()
            });
            assert!(
                used,
                "'{}': nothing in {allowed} needs the exception any more: take it out here",
                rule.says
            );
        }
    }
}

#[test]
fn security_md_names_the_files_with_unsafe_code() {
    let rule = RULES.iter().find(|rule| rule.words.contains(&"unsafe {")).unwrap();
    let page = super::text(Path::new("SECURITY.md"));
    let (_, section) = page.split_once("## Unsafe code").unwrap();
    let (section, _) = section.split_once("\n## ").unwrap();
    let rows = section.lines().filter_map(|line| line.strip_prefix("| `"));
    let mut named: Vec<&str> = rows.filter_map(|row| row.split('`').next()).collect();
    let mut allowed = rule.allowed.to_vec();
    named.sort_unstable();
    allowed.sort_unstable();
    assert_eq!(named, allowed);
}

#[test]
fn what_is_planted_is_found() {
    let spawn = RULES.iter().find(|rule| rule.words.contains(&"thread::spawn(")).unwrap();
    let found = |text| violations(spawn, Path::new("codec/src/lib.rs"), text).len();
    assert_eq!(found("fn f() {\n    std::thread::spawn(|| ());\n}\n"), 1);
    assert_eq!(found("let url = \"http://x\"; thread::spawn(|| ());"), 1, "not a comment");
    assert_eq!(found("my_thread::spawn(f)"), 0, "another word");
    assert_eq!(found("// std::thread::spawn(f) is not used\n/// nor thread::spawn(g)\n"), 0);
    assert_eq!(found("let x = 1; // thread::spawn(f)\n"), 0);
    assert_eq!(found("#[cfg(test)]\nmod tests {\n    thread::spawn(f);\n}\n"), 0);
    let simulator = RULES.iter().find(|rule| rule.words.contains(&"mocapd_simulator")).unwrap();
    let at =
        |path: &str| violations(simulator, Path::new(path), "use mocapd_simulator::pty;").len();
    assert_eq!((at("src/cli/demo.rs"), at("src/cli/bench/device.rs")), (0, 0));
    assert_eq!(
        (at("acquire/src/rig/mod.rs"), at("src/cli/record.rs"), at("take/src/lib.rs")),
        (1, 1, 1)
    );
}

/// One line for each place where a word of the rule stands and may not.
fn violations(rule: &Rule, path: &Path, text: &str) -> Vec<String> {
    if rule.allowed.iter().any(|allowed| begins(path, allowed)) {
        return Vec::new();
    }
    let lines = product_lines(text).enumerate();
    lines
        .filter_map(|(index, line)| {
            let word = rule.words.iter().find(|word| says(line, word))?;
            let place = format!("{}:{}", path.display(), index + 1);
            Some(format!("  {place}: `{word}`: {}", rule.says))
        })
        .collect()
}

/// Whether the word stands in the line as a word of its own: `NewFile::create` is no `File::create`.
fn says(line: &str, word: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    line.match_indices(word).any(|(at, _)| !line[..at].ends_with(is_part))
}

fn begins(path: &Path, allowed: &str) -> bool {
    path.to_str().is_some_and(|path| path.starts_with(allowed))
}

/// The lines of a file without comments, up to its unit tests, which stand at its end.
fn product_lines(text: &str) -> impl Iterator<Item = &str> {
    let product = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    product.lines().map(|line| match line.trim_start() {
        comment if comment.starts_with("//") => "",
        // A space before it: `://` of an address is no comment.
        _ => line.split_once(" //").map_or(line, |(code, _)| code),
    })
}
