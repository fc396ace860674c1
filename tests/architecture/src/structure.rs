//! Figures of the structure by crate: files, lines of code, functions that are too long or have too many parameters.

use std::{collections::BTreeMap, path::Path};

use proc_macro2::TokenStream;
use syn::{
    Attribute, Block, FnArg, ImplItemFn, Item, ItemFn, Signature, TraitItemFn, Type,
    spanned::Spanned,
    visit::{self, Visit},
};

/// Maximum number of lines of a function, from its signature to its closing brace.
pub const FUNCTION_LINES_MAX: usize = 80;

/// Maximum number of parameters of a function, without `self` and with every member of a tuple counted.
pub const PARAMETERS_MAX: usize = 6;

/// Files with fewer lines than this count as small.
pub const SMALL_FILE_LINES: usize = 60;

/// The figures of one crate.
#[derive(Clone, Debug, Default)]
pub struct CrateFigures {
    /// Rust files, without tests, benches and examples.
    pub files: usize,
    /// Files of fewer than [`SMALL_FILE_LINES`] lines.
    pub small_files: usize,
    /// Lines that are neither blank nor a comment, without unit tests.
    pub code_lines: usize,
    /// `path:line name: lines` of each function that is too long.
    pub long_functions: Vec<String>,
    /// `path:line name: parameters` of each function that has too many.
    pub wide_functions: Vec<String>,
}

/// Computes the figures by crate: by the folder before `src/` in the path; `src` itself is the program.
#[must_use]
pub fn figures(sources: &[(String, String)]) -> BTreeMap<String, CrateFigures> {
    let mut crates: BTreeMap<String, CrateFigures> = BTreeMap::new();
    for (path, text) in sources {
        let figures = crates.entry(crate_of(path)).or_default();
        figures.files += 1;
        figures.small_files += usize::from(text.lines().count() < SMALL_FILE_LINES);
        let Ok(file) = syn::parse_file(text) else {
            continue;
        };
        figures.code_lines += code_lines(text, &file);
        let mut functions = Functions { path, figures };
        functions.visit_file(&file);
    }
    crates
}

/// The folder of a crate, from a path relative to the project's root.
#[must_use]
pub fn crate_of(path: &str) -> String {
    let folder = path.split_once("/src/").map_or("src", |(folder, _)| folder);
    if Path::new(path).starts_with("src") { "src".to_owned() } else { folder.to_owned() }
}

/// The files of one crate, by their path below its `src`.
#[must_use]
pub fn files_of(sources: &[(String, String)], name: &str) -> BTreeMap<String, String> {
    let files = sources.iter().filter(|(path, _)| crate_of(path) == name);
    files
        .map(|(path, text)| {
            let (_, below) = path.split_once("src/").unwrap_or_default();
            (below.to_owned(), text.clone())
        })
        .collect()
}

fn code_lines(text: &str, file: &syn::File) -> usize {
    let mut is_test = vec![false; text.lines().count() + 1];
    mark_tests(&file.items, &mut is_test);
    let mut in_comment = false;
    let lines = text.lines().enumerate().filter(|&(index, line)| {
        let line = line.trim();
        let was_in_comment = in_comment;
        in_comment = (in_comment || line.starts_with("/*")) && !line.ends_with("*/");
        let is_comment = was_in_comment || line.starts_with("//") || line.starts_with("/*");
        !(is_test[index] || is_comment || line.is_empty())
    });
    lines.count()
}

/// Marks the lines of items that are compiled for tests only.
fn mark_tests(items: &[Item], is_test: &mut [bool]) {
    for item in items {
        if is_for_tests(attributes(item)) {
            let span = item.span();
            for line in span.start().line..=span.end().line {
                is_test[line - 1] = true;
            }
        } else if let Item::Mod(module) = item
            && let Some((_, items)) = &module.content
        {
            mark_tests(items, is_test);
        }
    }
}

/// Whether the attributes include `#[cfg(test)]` or `#[test]`.
pub(crate) fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let is_test_of_cfg = |tokens: &TokenStream| tokens.to_string() == "test";
        attribute.path().is_ident("test")
            || attribute.path().is_ident("cfg")
                && attribute.meta.require_list().is_ok_and(|list| is_test_of_cfg(&list.tokens))
    })
}

pub(crate) fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

struct Functions<'a> {
    path: &'a str,
    figures: &'a mut CrateFigures,
}

impl Functions<'_> {
    fn measure(&mut self, signature: &Signature, body: Option<&Block>) {
        let name = &signature.ident;
        let start = signature.fn_token.span.start().line;
        let lines = body.map_or(0, |body| body.span().end().line + 1 - start);
        if lines > FUNCTION_LINES_MAX {
            self.figures.long_functions.push(format!("{}:{start} {name}: {lines}", self.path));
        }
        let values: usize = signature
            .inputs
            .iter()
            .map(|input| match input {
                FnArg::Receiver(_) => 0,
                FnArg::Typed(argument) => values_in(&argument.ty),
            })
            .sum();
        if values > PARAMETERS_MAX {
            self.figures.wide_functions.push(format!("{}:{start} {name}: {values}", self.path));
        }
    }
}

impl<'ast> Visit<'ast> for Functions<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if !is_for_tests(attributes(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_fn(&mut self, item: &'ast ItemFn) {
        self.measure(&item.sig, Some(&item.block));
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast ImplItemFn) {
        self.measure(&item.sig, Some(&item.block));
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast TraitItemFn) {
        self.measure(&item.sig, item.default.as_ref());
        visit::visit_trait_item_fn(self, item);
    }
}

/// Counts the values in a type: a tuple, or a reference to one, counts as many as it has members.
fn values_in(kind: &Type) -> usize {
    match kind {
        Type::Tuple(tuple) => tuple.elems.iter().map(values_in).sum(),
        Type::Reference(reference) => values_in(&reference.elem),
        Type::Paren(inner) => values_in(&inner.elem),
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> CrateFigures {
        let sources = [("codec/src/lib.rs".to_owned(), text.to_owned())];
        figures(&sources)["codec"].clone()
    }

    #[test]
    fn tests_comments_and_blank_lines_are_not_code() {
        let text = "//! A page.\n\n/* more\nof it */\nfn f() {\n    // why\n}\n\n#[cfg(test)]\nmod tests {\n    fn g() {}\n}\n";
        assert_eq!(of(text).code_lines, 2);
    }

    #[test]
    fn members_of_tuples_are_counted_and_receivers_are_not() {
        let wide = |parameters: &str| {
            let text =
                format!("struct S; impl S {{ fn f({parameters}) {{ fn inside(x: u8) {{}} }} }}");
            of(&text).wide_functions.len()
        };
        assert_eq!(wide("&self, a: u8, b: u8, c: u8, d: u8, e: u8, f: u8"), 0);
        assert_eq!(wide("a: u8, b: u8, c: u8, d: u8, e: &(u8, u8, u8)"), 1);
        assert_eq!(wide("a: ((u8, u8), (u8, u8)), b: Vec<(u8, u8)>, c: u8"), 0);
    }

    #[test]
    fn long_functions_are_found_at_any_nesting() {
        let body = "x();\n".repeat(FUNCTION_LINES_MAX);
        let long = |text: String| of(&text).long_functions.len();
        assert_eq!(long(format!("fn f() {{\n{body}}}")), 1);
        assert_eq!(long(format!("trait T {{ fn f() {{\n{body}}} }}")), 1);
        assert_eq!(long(format!("fn g() {{ fn f() {{\n{}}} }}", &body[10..])), 0);
        assert_eq!(long(format!("#[cfg(test)]\nmod tests {{ fn f() {{\n{body}}} }}")), 0);
    }
}
