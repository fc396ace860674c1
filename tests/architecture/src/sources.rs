//! Checks the invariants of ARCHITECTURE.md that are visible in the text of the source.

use std::path::{Path, PathBuf};

/// Words that may occur only in some files.
struct Rule {
    /// The invariant, as a failure states it.
    invariant: &'static str,
    words: &'static [&'static str],
    /// Files, folders (with `/` at the end), or beginnings of either, where the words may occur.
    allowed: &'static [&'static str],
}

const RULES: &[Rule] = &[
    Rule {
        invariant: "only the demo and the benchmarks of the program use the simulator",
        words: &["mocapd_simulator"],
        allowed: &["src/cli/demo", "src/cli/bench", "simulator/src/"],
    },
    Rule {
        invariant: "only threads.rs and the import path of acquire, the lookup of host names, the clients of stores, and the programs start threads",
        words: &["thread::Builder", "thread::{Builder", "thread::scope"],
        allowed: &[
            "acquire/src/threads.rs",
            "acquire/src/pipeline/offline.rs",
            "cli/src/stop.rs",
            // Looking up a name cannot be cancelled, and may take longer than a reader can wait.
            "drivers/src/transport/network/connect.rs",
            // A stream that does not answer must not keep the samples of others waiting.
            "drivers/src/transport/lsl/discovery.rs",
            "simulator/src/cli/generate.rs",
            "store/src/cloud/connect.rs",
        ],
    },
    Rule {
        invariant: "unnamed threads cannot be identified: use threads::spawn",
        words: &["thread::spawn("],
        allowed: &[],
    },
    Rule {
        invariant: "only acquire, the service, the programs, simulated lines and transports read clocks",
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
            "simulator/src/line.rs",
            "simulator/src/gadget.rs",
            "simulator/src/lsl/serve.rs",
            "cli/src/stop.rs",
            "simulator/src/cli/mod.rs",
            "drivers/src/transport/",
        ],
    },
    Rule {
        invariant: "only the command lines print: results to stdout, messages to stderr",
        words: &["println!", "print!(", "eprintln!", "eprint!(", "io::stdout", "io::stderr"],
        allowed: &["src/cli/", "simulator/src/cli/"],
    },
    Rule {
        invariant: "only main.rs ends the process",
        words: &["process::exit", "process::abort", "ExitCode"],
        allowed: &["src/main.rs", "src/outcome.rs", "simulator/src/main.rs"],
    },
    Rule {
        invariant: "nothing on the sample path takes a lock",
        words: &["Mutex", "RwLock", "Condvar"],
        // The log's rate limit and the queue of triggers are used by threads that may wait. The service and the data
        // plane share a lock in one place only: the writer takes it once per stretch.
        // The commands of the program that read and write files are on no sample path.
        allowed: &[
            "acquire/src/files/new_file.rs",
            "acquire/src/pipeline/progress.rs",
            // The addresses of machines, which threads look up while streams are searched for.
            "drivers/src/transport/lsl/discovery.rs",
            // What was found in the fonts of the system.
            "report/src/plot/png.rs",
            "src/cli/",
            "take/src/foreign/content.rs",
            "take/src/sampled/recording.rs",
            "service/src/engine/",
            "service/src/http/",
            "service/src/log.rs",
            // What a publisher reports, five times a second.
            "service/src/publish/mod.rs",
            "service/src/trigger/queue.rs",
            "store/src/cloud.rs",
            "store/src/cloud/connect.rs",
            "store/src/store.rs",
        ],
    },
    Rule {
        invariant: "every queue is bounded",
        words: &["unbounded(", "mpsc::channel", "VecDeque::new()"],
        allowed: &[],
    },
    Rule {
        invariant: "codec, take and the protocols are sans-io: no files, no sockets, no devices",
        words: &["fs::", "{fs,", "net::", "env::"],
        // The program and the simulator share a function that opens regular files, and the one that writes manual pages.
        allowed: &[
            "acquire/src/",
            "service/src/",
            "src/",
            "drivers/src/plain_file.rs",
            "cli/src/manual.rs",
            "cli/src/stop.rs",
            "simulator/src/cli/",
            "simulator/src/pty/",
            "simulator/src/gadget.rs",
            "drivers/src/transport/",
            // The crate of LSL calls so what has its descriptions.
            "drivers/src/lsl/description.rs",
            "drivers/src/lsl/outlet/",
            "simulator/src/lsl/",
            "simulator/src/natnet/serve.rs",
            "simulator/src/qtm/serve.rs",
            "store/src/cloud/connect.rs",
            "store/src/backend.rs",
            // Addresses, which are plain data.
            "drivers/src/natnet/",
            "simulator/src/natnet/mod.rs",
            "drivers/src/qtm/command.rs",
            "drivers/src/qtm/server/",
            "simulator/src/qtm/mod.rs",
        ],
    },
    Rule {
        invariant: "only files.rs and the store of files, which never overwrite one, and the simulator create files",
        words: &["File::create", "File::create_new", "OpenOptions", "fs::write(", "fs::rename("],
        // An upgrade replaces manual pages.
        allowed: &[
            "acquire/src/files",
            "cli/src/manual.rs",
            "simulator/src/cli/mod.rs",
            "store/src/backend.rs",
        ],
    },
    Rule {
        invariant: "only one module names the ring buffer crate, which could be replaced",
        words: &["ringbuf"],
        allowed: &["acquire/src/pipeline/ring.rs"],
    },
    Rule {
        invariant: "only the HTTP API and its client, and the clients of stores, are async",
        words: &["tokio::", "axum::", "hyper::", "async fn", "async move", ".await"],
        allowed: &["service/src/http/", "src/cli/ctl/", "store/src/cloud"],
    },
    Rule {
        invariant: "only small records behind a checksum use bincode",
        words: &["bincode"],
        allowed: &["take/src/record/"],
    },
    Rule {
        invariant: "only transports open devices",
        words: &["serialport", "nusb", "nix::"],
        allowed: &["drivers/src/transport/", "drivers/src/registry.rs"],
    },
    Rule {
        invariant: "only one module of the simulator creates USB devices",
        words: &["usb_gadget::"],
        allowed: &["simulator/src/gadget.rs"],
    },
    Rule {
        invariant: "unsafe code is for two system calls that no safe crate wraps, and for one function that is \
               compiled for more CPU features than the crate",
        words: &["unsafe {", "unsafe fn", "unsafe impl"],
        allowed: &["codec/src/coding/isa.rs", "drivers/src/transport/tty.rs"],
    },
];

/// The sources of the workspace, without the Python package, which is a separate workspace.
fn product_sources() -> Vec<PathBuf> {
    let sources = super::product_sources(&super::root());
    sources.into_iter().filter(|path| !path.starts_with("python")).collect()
}

#[test]
fn the_source_keeps_the_invariants() {
    let sources: Vec<_> =
        product_sources().into_iter().map(|path| (super::text(&path), path)).collect();
    assert!(sources.len() > 100, "found only {} sources", sources.len());
    let mut found = Vec::new();
    for rule in RULES {
        for (text, path) in &sources {
            found.extend(violations(rule, path, text));
        }
    }
    assert!(found.is_empty(), "invariants of ARCHITECTURE.md are violated:\n{}", found.join("\n"));
}

#[test]
fn every_exception_is_still_needed() {
    for rule in RULES {
        for &allowed in rule.allowed {
            let used = product_sources().iter().any(|path| {
                let strict = Rule { allowed: &[], ..*rule };
                begins(path, allowed) && !violations(&strict, path, &super::text(path)).is_empty()
            });
            assert!(
                used,
                "'{}': nothing in {allowed} needs the exception any more: remove it from the rule",
                rule.invariant
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
fn planted_violations_are_found() {
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
    assert_eq!((at("src/cli/demo.rs"), at("src/cli/bench/mod.rs")), (0, 0));
    assert_eq!(
        (at("acquire/src/rig/mod.rs"), at("src/cli/record.rs"), at("take/src/lib.rs")),
        (1, 1, 1)
    );
}

/// One line for each place where a word of the rule occurs outside the allowed files.
fn violations(rule: &Rule, path: &Path, text: &str) -> Vec<String> {
    if rule.allowed.iter().any(|allowed| begins(path, allowed)) {
        return Vec::new();
    }
    let lines = product_lines(text).enumerate();
    lines
        .filter_map(|(index, line)| {
            let word = rule.words.iter().find(|word| has_word(line, word))?;
            let place = format!("{}:{}", path.display(), index + 1);
            Some(format!("  {place}: `{word}`: {}", rule.invariant))
        })
        .collect()
}

/// Whether the line contains the word, and not as the end of a longer one: `NewFile::create` is not `File::create`.
fn has_word(line: &str, word: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    line.match_indices(word).any(|(at, _)| !line[..at].ends_with(is_part))
}

fn begins(path: &Path, allowed: &str) -> bool {
    path.to_str().is_some_and(|path| path.starts_with(allowed))
}

/// The lines of a file without comments, up to the unit tests at its end.
fn product_lines(text: &str) -> impl Iterator<Item = &str> {
    let product = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    product.lines().map(|line| match line.trim_start() {
        comment if comment.starts_with("//") => "",
        // With a space before it, because the `://` of an address is not a comment.
        _ => line.split_once(" //").map_or(line, |(code, _)| code),
    })
}
