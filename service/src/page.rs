//! The files of the dashboard and the player, which are compiled into the program, and the player as one file.

use std::{
    collections::{BTreeMap, BTreeSet},
    io::{self, Write},
};

use anyhow::{Context, bail, ensure};
use include_dir::{Dir, include_dir};
use mocapd_take::interchange::page_motion::base64;
use sha2::{Digest, Sha256};

/// The folder as it was when the program was built.
pub(crate) static WEB: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../web");

/// The page of the player, and the module that a page with a take in it begins with.
pub(crate) const PLAYER: &str = "player.html";
const SHARED: &str = "shared.js";

/// Whether this is the path of a file of the pages.
pub(crate) fn is_file(path: &str) -> bool {
    path == "/" || path.strip_prefix('/').is_some_and(|name| WEB.get_file(name).is_some())
}

/// The player as one file without the take, which [`write`](Self::write) puts into it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SharedPage {
    /// The page up to the take.
    head: String,
    /// The script and the end of the page.
    tail: String,
}

impl SharedPage {
    /// Puts the files of the player into one. It loads nothing, and its policy forbids that it loads anything.
    ///
    /// # Errors
    /// A file of the page is not as expected, which is a bug.
    pub fn new() -> anyhow::Result<Self> {
        let script = joined(SHARED)?;
        let page = text(PLAYER)?;
        let (head, body) = page.split_once("</head>\n<body>").context("the player has no body")?;
        let (body, _) = body.rsplit_once("</body>").context("the player's body has no end")?;
        let (mut head, styles) = without_files(head)?;
        let styles = without_comments(&styles);
        ensure!(!styles.contains("</") && !script.contains("</script"), "a file ends its element");
        let policy = format!(
            "default-src 'none'; script-src '{}'; style-src '{}'; img-src data:; base-uri 'none'; form-action 'none'",
            hash(&script),
            hash(&styles)
        );
        let icon = base64(text("icon.svg")?.as_bytes());
        head += &format!(
            "  <meta http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\n  \
             <meta name=\"generator\" content=\"mocapd {}\">\n  \
             <link rel=\"icon\" href=\"data:image/svg+xml;base64,{icon}\">\n  \
             <style>{styles}</style>\n</head>\n<body>{body}",
            env!("CARGO_PKG_VERSION")
        );
        let tail = format!("<script type=\"module\">{script}</script>\n</body>\n</html>\n");
        Ok(Self { head, tail })
    }

    /// Writes the page. `put_motion` writes the blocks of the motion, each as a line of base64, and returns the overview of
    /// the take as JSON.
    ///
    /// # Errors
    /// Those of `put_motion`, and of writing.
    pub fn write<W: Write, E: From<io::Error>>(
        &self,
        out: &mut W,
        put_motion: impl FnOnce(&mut W) -> Result<String, E>,
    ) -> Result<(), E> {
        out.write_all(self.head.as_bytes())?;
        out.write_all(b"<script id=\"motion\" type=\"text/plain\">\n")?;
        let overview = put_motion(out)?;
        // A label may contain the end of the element, or the beginning of a comment in it.
        let overview = overview.replace('<', "\\u003c");
        let overview = format!(
            "</script>\n<script id=\"take\" type=\"application/json\">{overview}</script>\n"
        );
        out.write_all(overview.as_bytes())?;
        out.write_all(self.tail.as_bytes())?;
        Ok(())
    }

    /// Size of the page without a take, in bytes.
    #[must_use]
    pub fn len_bytes(&self) -> usize {
        self.head.len() + self.tail.len()
    }
}

/// A file of the folder.
fn text(name: &str) -> anyhow::Result<&'static str> {
    let file = WEB.get_file(name).and_then(|file| file.contents_utf8());
    file.with_context(|| format!("the program lacks {name}: please report this bug"))
}

/// The head of a page without the files that it loads, and its style sheets as one.
fn without_files(head: &str) -> anyhow::Result<(String, String)> {
    let (mut kept, mut styles) = (String::new(), String::new());
    for line in head.lines() {
        let sheet = line.trim().strip_prefix("<link rel=\"stylesheet\" href=\"/");
        if let Some(sheet) = sheet {
            styles += text(sheet.strip_suffix("\">").context("a link without its end")?)?;
        } else if !line.contains("href=") && !line.contains("src=") {
            kept += line;
            kept.push('\n');
        }
    }
    Ok((kept, styles))
}

/// The hash by which a policy allows an inline script or style sheet.
fn hash(content: &str) -> String {
    format!("sha256-{}", base64(&Sha256::digest(content.as_bytes())))
}

/// A script or style sheet without its comments and indentation, which take a third of it. In the files of the page a
/// comment is on lines of its own.
fn without_comments(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut is_comment = false;
    for line in text.lines().map(str::trim) {
        is_comment |= line.starts_with("/*");
        if is_comment || line.starts_with("//") || line.is_empty() {
            is_comment &= !line.ends_with("*/");
            continue;
        }
        kept += line;
        kept.push('\n');
    }
    kept
}

/// A module and all that it imports as one script: each module is a function that returns its exports.
fn joined(entry: &str) -> anyhow::Result<String> {
    let mut modules = BTreeMap::new();
    let mut order = Vec::new();
    collect(entry, &mut BTreeSet::new(), &mut modules, &mut order)?;
    let mut script = String::from("\"use strict\";\n");
    for name in &order {
        let module = modules.get(name).with_context(|| format!("no module {name}"))?;
        script += module;
    }
    Ok(without_comments(&script))
}

/// Adds a module after those that it imports. `open` are the modules whose imports are being added.
fn collect(
    name: &str,
    open: &mut BTreeSet<String>,
    modules: &mut BTreeMap<String, String>,
    order: &mut Vec<String>,
) -> anyhow::Result<()> {
    if modules.contains_key(name) {
        return Ok(());
    }
    ensure!(open.insert(name.to_owned()), "{name} imports itself, through others");
    let module = Module::parse(name)?;
    for (imported, _) in &module.imports {
        collect(imported, open, modules, order)?;
    }
    modules.insert(name.to_owned(), module.wrapped());
    order.push(name.to_owned());
    Ok(())
}

/// A module of the page. The page's modules import and export by name only.
struct Module {
    name: String,
    /// The modules that it imports, and the names from each.
    imports: Vec<(String, String)>,
    exports: Vec<String>,
    body: String,
}

impl Module {
    fn parse(name: &str) -> anyhow::Result<Self> {
        let mut module = Self {
            name: name.to_owned(),
            imports: Vec::new(),
            exports: Vec::new(),
            body: String::new(),
        };
        let mut rest = text(name)?;
        while let Some((line, after)) = rest.split_once('\n') {
            if line.starts_with("import ") {
                let (statement, after) = rest.split_once(";\n").context("an endless import")?;
                module.import(statement)?;
                rest = after;
                continue;
            }
            module.line(line)?;
            rest = after;
        }
        Ok(module)
    }

    /// `import { a, b } from "./name.js"`.
    fn import(&mut self, statement: &str) -> anyhow::Result<()> {
        let parts =
            statement.strip_prefix("import {").and_then(|rest| rest.split_once("} from \"./"));
        let Some((names, file)) = parts else { bail!("{}: cannot join {statement}", self.name) };
        let file = file.strip_suffix('"').context("an import without its end")?;
        self.imports.push((file.to_owned(), names.trim().replace(" as ", ": ")));
        Ok(())
    }

    /// A line of the module; a declaration may be exported.
    fn line(&mut self, line: &str) -> anyhow::Result<()> {
        let Some(declaration) = line.strip_prefix("export ") else {
            self.body += line;
            self.body.push('\n');
            return Ok(());
        };
        let words = declaration.strip_prefix("async ").unwrap_or(declaration);
        let name =
            ["function ", "const ", "class "].iter().find_map(|kind| words.strip_prefix(kind));
        let name =
            name.and_then(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next());
        let Some(name) = name.filter(|name| !name.is_empty()) else {
            bail!("{}: cannot join {line}", self.name);
        };
        self.exports.push(name.to_owned());
        self.body += declaration;
        self.body.push('\n');
        Ok(())
    }

    /// The name of the variable that holds a module's exports.
    fn variable(name: &str) -> String {
        format!("module_{}", name.trim_end_matches(".js"))
    }

    fn wrapped(&self) -> String {
        let imports: String = self
            .imports
            .iter()
            .map(|(file, names)| format!("const {{ {names} }} = {};\n", Self::variable(file)))
            .collect();
        let exports = self.exports.join(", ");
        format!(
            "const {} = (() => {{\n{imports}{}return {{ {exports} }};\n}})();\n",
            Self::variable(&self.name),
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shared_page_is_one_file_that_loads_nothing() {
        let page = SharedPage::new().unwrap();
        let mut file = Vec::new();
        page.write(&mut file, |out| -> io::Result<String> {
            out.write_all(b"AAAA\n")?;
            Ok(r#"{"name":"</script><!--"}"#.to_owned())
        })
        .unwrap();
        let file = String::from_utf8(file).unwrap();
        assert!(file.contains("default-src 'none'"));
        let head = file.split_once("</head>").unwrap().0;
        for part in ["<!doctype html>", "charset=\"utf-8\"", "viewport", "<title>", "<style>:root"]
        {
            assert_eq!(head.matches(part).count(), 1, "{part}");
        }
        // The link to the dashboard is hidden.
        let rest = file.replace("href=\"/\" hidden", "");
        for loaded in ["src=", "href=\"/", "import ", "http://1", "https://", "/v1/"] {
            assert!(!rest.contains(loaded), "{loaded}");
        }
        assert_eq!(file.matches("</script>").count(), 3, "no label ends an element");
        assert!(file.contains(r#"{"name":"\u003c/script>\u003c!--"}"#));
        assert!(page.len_bytes() < 120_000, "{} bytes", page.len_bytes());
    }

    #[test]
    fn modules_are_joined_after_those_that_they_import() {
        let script = joined(SHARED).unwrap();
        let at = |name: &str| script.find(&format!("const {} = ", Module::variable(name))).unwrap();
        assert!(at("format.js") < at("dom.js") && at("dom.js") < at("player.js"));
        assert!(at("player.js") < at("shared.js"));
        assert!(!script.contains("\nexport ") && !script.contains("\nimport "));
        assert!(!script.contains("module_api"), "nothing of the service");
    }
}
