//! Cycles between files: a graph in which each file of a crate points to the files whose names it uses, and its cycles.
//!
//! To declare a module or to re-export its names (`pub use`) does not count as use; to call into it does. Names are
//! followed through re-exports to the file that defines them. A submodule's use of its parent modules does not count:
//! they are one.

use std::collections::{BTreeMap, BTreeSet};

use syn::{
    Item, Path, UseTree, Visibility,
    visit::{self, Visit},
};

use crate::structure::{attributes, is_for_tests};

/// The names in a module.
#[derive(Debug, Default)]
struct Module {
    file: String,
    defined: BTreeSet<String>,
    /// The path that each imported name refers to.
    bound: BTreeMap<String, Vec<String>>,
    /// The names among `bound` that are re-exported.
    re_exported: BTreeSet<String>,
    globs: Vec<Vec<String>>,
    /// Paths in its code.
    named: Vec<Vec<String>>,
}

type Modules = BTreeMap<Vec<String>, Module>;

/// For each file, the files whose names it uses.
pub type Graph = BTreeMap<String, BTreeSet<String>>;

/// The cycles between the files of one crate: groups of files that use one another, each sorted.
#[must_use]
pub fn cycles(graph: &Graph) -> Vec<Vec<String>> {
    let reached: BTreeMap<&str, BTreeSet<&str>> =
        graph.keys().map(|file| (file.as_str(), reachable(graph, file))).collect();
    let mut found = Vec::new();
    let mut seen = BTreeSet::new();
    for (&file, others) in &reached {
        if !others.contains(file) || !seen.insert(file) {
            continue;
        }
        let back = others
            .iter()
            .filter(|&&other| reached.get(other).is_some_and(|theirs| theirs.contains(file)));
        let group: Vec<String> = back.map(|&other| other.to_owned()).collect();
        seen.extend(others.iter().filter(|&&other| group.iter().any(|name| name == other)));
        found.push(group);
    }
    found
}

fn reachable<'a>(graph: &'a Graph, from: &str) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut next: Vec<&str> = vec![from];
    while let Some(file) = next.pop() {
        for other in graph.get(file).into_iter().flatten() {
            if reached.insert(other.as_str()) {
                next.push(other);
            }
        }
    }
    reached
}

/// Builds the graph of one crate from its files: paths relative to the crate's `src`, with their texts.
#[must_use]
pub fn graph(sources: &BTreeMap<String, String>) -> Graph {
    let mut modules = Modules::new();
    for root in ["lib.rs", "main.rs"] {
        if sources.contains_key(root) {
            read_file(sources, root, Vec::new(), &mut modules);
        }
    }
    let mut graph = Graph::new();
    for (place, module) in &modules {
        let taken = graph.entry(module.file.clone()).or_default();
        let used = module.bound.iter().filter(|(name, _)| !module.re_exported.contains(*name));
        let globs = module.globs.iter();
        for path in used.map(|(_, path)| path).chain(globs).chain(&module.named) {
            if let Some(owner) = owner(&modules, place, path, 0)
                && modules[&owner].file != module.file
                && !place.starts_with(&owner)
            {
                taken.insert(modules[&owner].file.clone());
            }
        }
    }
    graph
}

fn read_file(
    sources: &BTreeMap<String, String>,
    file: &str,
    place: Vec<String>,
    modules: &mut Modules,
) {
    let Some(parsed) = sources.get(file).and_then(|text| syn::parse_file(text).ok()) else {
        return;
    };
    read_items(sources, file, place, &parsed.items, modules);
}

fn read_items(
    sources: &BTreeMap<String, String>,
    file: &str,
    place: Vec<String>,
    items: &[Item],
    modules: &mut Modules,
) {
    // The two roots of a crate, of its library and its program, are both the module with the empty path.
    let mut module = modules.remove(&place).unwrap_or_default();
    file.clone_into(&mut module.file);
    for item in items.iter().filter(|item| !is_for_tests(attributes(item))) {
        match item {
            Item::Mod(inner) => {
                let below = [place.as_slice(), &[inner.ident.to_string()]].concat();
                match &inner.content {
                    Some((_, items)) => read_items(sources, file, below, items, modules),
                    None => {
                        let path = below.join("/");
                        let candidates = [format!("{path}.rs"), format!("{path}/mod.rs")];
                        let found = candidates.iter().find(|path| sources.contains_key(*path));
                        if let Some(path) = found {
                            read_file(sources, path, below, modules);
                        }
                    }
                }
            }
            Item::Use(item) => {
                let is_public = !matches!(item.vis, Visibility::Inherited);
                read_use(&item.tree, &mut Vec::new(), is_public, &mut module);
            }
            item => {
                module.defined.extend(name_of(item));
                Paths(&mut module.named).visit_item(item);
            }
        }
    }
    modules.insert(place, module);
}

fn name_of(item: &Item) -> Option<String> {
    Some(match item {
        Item::Const(item) => item.ident.to_string(),
        Item::Enum(item) => item.ident.to_string(),
        Item::Fn(item) => item.sig.ident.to_string(),
        Item::Macro(item) => item.ident.as_ref()?.to_string(),
        Item::Static(item) => item.ident.to_string(),
        Item::Struct(item) => item.ident.to_string(),
        Item::Trait(item) => item.ident.to_string(),
        Item::Type(item) => item.ident.to_string(),
        _ => return None,
    })
}

fn read_use(tree: &UseTree, before: &mut Vec<String>, is_public: bool, module: &mut Module) {
    match tree {
        UseTree::Path(path) => {
            before.push(path.ident.to_string());
            read_use(&path.tree, before, is_public, module);
            before.pop();
        }
        UseTree::Group(group) => {
            for tree in &group.items {
                read_use(tree, before, is_public, module);
            }
        }
        UseTree::Glob(_) => module.globs.push(before.clone()),
        UseTree::Name(name) => {
            let name = name.ident.to_string();
            let path = match (name.as_str(), before.last()) {
                ("self", _) => before.clone(),
                _ => [before.as_slice(), std::slice::from_ref(&name)].concat(),
            };
            let bound = if name == "self" { before.last().cloned() } else { Some(name) };
            bind(bound, path, is_public, module);
        }
        UseTree::Rename(rename) => {
            let path = [before.as_slice(), &[rename.ident.to_string()]].concat();
            bind(Some(rename.rename.to_string()), path, is_public, module);
        }
    }
}

fn bind(name: Option<String>, path: Vec<String>, is_public: bool, module: &mut Module) {
    if let Some(name) = name {
        if is_public {
            module.re_exported.insert(name.clone());
        }
        module.bound.insert(name, path);
    }
}

struct Paths<'a>(&'a mut Vec<Vec<String>>);

impl<'ast> Visit<'ast> for Paths<'_> {
    fn visit_path(&mut self, path: &'ast Path) {
        self.0.push(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        visit::visit_path(self, path);
    }
}

/// Maximum number of re-exports through which a name is followed.
const DEPTH_MAX: usize = 16;

/// The module that defines the last name of a path, as seen from a module; `None` if no file of the crate does.
fn owner(modules: &Modules, from: &[String], path: &[String], depth: usize) -> Option<Vec<String>> {
    let mut place = from.to_vec();
    let mut rest = path;
    let mut is_first = true;
    while let Some((name, after)) = rest.split_first() {
        let below = [place.as_slice(), std::slice::from_ref(name)].concat();
        match name.as_str() {
            "crate" if is_first => place.clear(),
            "self" if is_first => {}
            "super" => {
                place.pop();
            }
            _ if modules.contains_key(&below) => place = below,
            _ => {
                let module = &modules[&place];
                if module.defined.contains(name) {
                    return Some(place);
                }
                if depth > DEPTH_MAX {
                    return None;
                }
                if let Some(target) = module.bound.get(name) {
                    let whole = [target.as_slice(), after].concat();
                    // `use x::x` refers to another crate.
                    return if whole == path && place == from {
                        None
                    } else {
                        owner(modules, &place, &whole, depth + 1)
                    };
                }
                return module.globs.iter().find_map(|glob| {
                    let whole = [glob.as_slice(), rest].concat();
                    owner(modules, &place, &whole, depth + 1)
                });
            }
        }
        is_first = false;
        rest = after;
    }
    Some(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycles_of(files: &[(&str, &str)]) -> Vec<Vec<String>> {
        let sources =
            files.iter().map(|&(path, text)| (path.to_owned(), text.to_owned())).collect();
        cycles(&graph(&sources))
    }

    #[test]
    fn two_files_that_use_each_other_are_a_cycle() {
        let root = ("lib.rs", "mod a; mod b; mod c;");
        let c = ("c.rs", "use super::a::A;");
        let a = ("a.rs", "use crate::b::B; pub struct A;");
        let found = cycles_of(&[root, a, ("b.rs", "use super::a::A; pub struct B;"), c]);
        assert_eq!(found, [["a.rs", "b.rs"]]);
        assert!(cycles_of(&[root, a, ("b.rs", "pub struct B;"), c]).is_empty());
    }

    #[test]
    fn names_are_followed_through_re_exports() {
        let root = ("lib.rs", "pub mod m;");
        let passes = ("m/mod.rs", "mod a; mod b; pub use a::A;");
        let a = ("m/a.rs", "pub struct A; fn f() { super::b::f() }");
        let found = cycles_of(&[root, passes, a, ("m/b.rs", "use super::A; pub fn f() {}")]);
        assert_eq!(found, [["m/a.rs", "m/b.rs"]]);
        assert!(cycles_of(&[root, passes, ("m/a.rs", "pub struct A;")]).is_empty());
    }

    #[test]
    fn a_module_and_its_submodules_are_one() {
        let root = ("lib.rs", "pub mod m; pub mod n;");
        let uses = ("m/mod.rs", "mod a; pub use a::A; pub fn f(a: A) {}");
        let n = ("n.rs", "pub fn g() { crate::m::f() }");
        assert!(cycles_of(&[root, uses, ("m/a.rs", "use super::f; pub struct A;"), n]).is_empty());
        let a = ("m/a.rs", "use crate::n::g; pub struct A;");
        assert_eq!(cycles_of(&[root, uses, a, n]), [["m/a.rs", "m/mod.rs", "n.rs"]]);
    }

    #[test]
    fn tests_do_not_count() {
        let root = ("lib.rs", "mod a; mod b;");
        let a = ("a.rs", "pub struct A; #[cfg(test)] mod tests { use crate::b::B; }");
        assert!(cycles_of(&[root, a, ("b.rs", "use crate::a::A; pub struct B;")]).is_empty());
    }
}
