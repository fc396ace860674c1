//! Checks the names that the source declares: each is a standard term, and is used for one thing.

use std::{collections::BTreeMap, sync::LazyLock};

use syn::{
    Field, File, Ident, ImplItemFn, Item, ItemEnum, ItemFn, ItemMod, ItemStruct, ItemTrait,
    ItemType, TraitItemFn,
    visit::{self, Visit},
};

use crate::{
    product_sources, root,
    structure::{attributes, crate_of, is_for_tests},
    text,
};

/// Names that this project once invented for things that have a standard name, and the name to use.
const OUT_OF_USE: &[(&str, &str)] = &[
    ("Answers", "IdempotentReplies"),
    ("Asked", "JsonBody, or what is requested"),
    ("Beat", "HeartbeatHandle"),
    ("Begun", "TakeHandle"),
    ("Coded", "DecodedTake"),
    ("Desk", "a command channel's sender and receiver"),
    ("Doorway", "Acceptor"),
    ("Front", "a header, or what was parsed of a chunk"),
    ("Glance", "LandmarkRegressor"),
    ("Held", "PreRollBuffer"),
    ("Judge", "OutlierGate"),
    ("Look", "FeatureVector"),
    ("Mended", "Repaired"),
    ("Preset", "DefaultValue"),
    ("Room", "DiskReserve"),
    ("Surroundings", "Environment"),
    ("Told", "what is sent, or stored"),
    ("TurnTransport", "PolledTransport"),
    ("UnixDoor", "BoundSocket"),
    ("While", "CancellableReader"),
    ("Who", "ThreadRole"),
    ("carry_out", "execute"),
    ("desk", "a command channel's sender and receiver"),
    ("glance", "regressor"),
    ("happenings", "events"),
    ("io_px", "interocular_px"),
    ("look", "poll, check or inspect"),
    ("mend", "repair"),
    ("mended", "repaired"),
    ("nod_deg", "pitch_deg"),
    ("octaves", "pyramid"),
    ("said", "message, reported or sent"),
    ("say", "report, log or send"),
    ("surroundings", "environment"),
    ("survey", "scan or analyse"),
    ("take_leave", "goodbye"),
    ("tell", "report, notify or set"),
    ("tells", "reports"),
    ("told", "reported or set"),
    ("weave", "cross-channel prediction"),
    ("words", "text or message; 16-bit words have their format in the name"),
];

/// Endings that can be misread as another unit, and the ones to use.
const OUT_OF_USE_AT_THE_END: &[(&str, &str)] = &[("_mhz", "_millihertz")];

/// The names in each file of the product, by its path: to parse all files takes seconds, so tests share them.
static NAMES: LazyLock<Vec<(String, Names)>> = LazyLock::new(|| {
    let paths = product_sources(&root()).into_iter().map(|path| path.display().to_string());
    paths.map(|path| (path.clone(), names(&text(path)))).collect()
});

/// Names that several modules of a crate may give a type, as in the standard library.
const IDIOMATIC: [&str; 4] = ["Args", "Error", "Iter", "Result"];

#[test]
fn no_name_is_invented_where_a_standard_one_exists() {
    let mut problems = Vec::new();
    for (path, names) in NAMES.iter() {
        for name in &names.all {
            let listed = OUT_OF_USE.iter().find(|(old, _)| old == name);
            let ending = OUT_OF_USE_AT_THE_END.iter().find(|(old, _)| name.ends_with(old));
            if let Some((_, new)) = listed.or(ending) {
                problems.push(format!("{path}: rename `{name}` to {new}"));
            }
        }
    }
    assert!(problems.is_empty(), "names that are not standard:\n  {}", problems.join("\n  "));
}

#[test]
fn no_two_types_of_a_crate_share_a_name() {
    let mut places: BTreeMap<(String, String), Vec<String>> = BTreeMap::new();
    for (path, names) in NAMES.iter() {
        for name in &names.types {
            if !IDIOMATIC.contains(&name.as_str()) {
                places.entry((crate_of(path), name.clone())).or_default().push(path.clone());
            }
        }
    }
    places.retain(|_, paths| paths.len() > 1);
    assert!(places.is_empty(), "types that share a name within a crate: {places:#?}");
}

/// The names that a file declares, except in unit tests.
#[derive(Default)]
struct Names {
    types: Vec<String>,
    all: Vec<String>,
}

fn names(source: &str) -> Names {
    let file: File = syn::parse_file(source).expect("the source compiles");
    let mut names = Names::default();
    names.visit_file(&file);
    names
}

impl Names {
    fn add(&mut self, name: &Ident) {
        self.all.push(name.to_string());
    }

    fn add_type(&mut self, name: &Ident) {
        self.types.push(name.to_string());
        self.add(name);
    }
}

impl<'ast> Visit<'ast> for Names {
    fn visit_item(&mut self, item: &'ast Item) {
        if !is_for_tests(attributes(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_struct(&mut self, item: &'ast ItemStruct) {
        self.add_type(&item.ident);
        visit::visit_item_struct(self, item);
    }

    fn visit_item_enum(&mut self, item: &'ast ItemEnum) {
        self.add_type(&item.ident);
        visit::visit_item_enum(self, item);
    }

    fn visit_item_trait(&mut self, item: &'ast ItemTrait) {
        self.add_type(&item.ident);
        visit::visit_item_trait(self, item);
    }

    fn visit_item_type(&mut self, item: &'ast ItemType) {
        self.add_type(&item.ident);
    }

    fn visit_item_mod(&mut self, item: &'ast ItemMod) {
        self.add(&item.ident);
        visit::visit_item_mod(self, item);
    }

    fn visit_item_fn(&mut self, item: &'ast ItemFn) {
        self.add(&item.sig.ident);
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast ImplItemFn) {
        self.add(&item.sig.ident);
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast TraitItemFn) {
        self.add(&item.sig.ident);
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_field(&mut self, field: &'ast Field) {
        if let Some(name) = &field.ident {
            self.add(name);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::names;

    #[test]
    fn names_are_found_except_in_tests() {
        let found = names(
            "mod m { struct S { field: u8 } } impl T for u8 { fn method() {} } #[cfg(test)] mod tests { struct Told; }",
        );
        assert_eq!(found.types, ["S"]);
        assert_eq!(found.all, ["m", "S", "field", "method"]);
    }
}
