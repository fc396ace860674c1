//! JSON objects of texts, numbers and other objects, in the order in which they are said.

/// An object under way.
#[derive(Debug, Default)]
pub(super) struct Object {
    members: Vec<String>,
}

impl Object {
    pub(super) fn text(self, name: &str, value: &str) -> Self {
        self.raw(name, &quoted(value))
    }

    /// A number; one that is not finite is `null`.
    pub(super) fn number(self, name: &str, value: f64) -> Self {
        let text = if value.is_finite() { value.to_string() } else { "null".to_owned() };
        self.raw(name, &text)
    }

    pub(super) fn count(self, name: &str, value: u64) -> Self {
        self.raw(name, &value.to_string())
    }

    pub(super) fn object(self, name: &str, value: &Self) -> Self {
        self.raw(name, &value.body())
    }

    /// A list of one object.
    pub(super) fn list_of(self, name: &str, value: &Self) -> Self {
        self.raw(name, &format!("[{}]", value.body()))
    }

    fn raw(mut self, name: &str, value: &str) -> Self {
        self.members.push(format!("{}: {value}", quoted(name)));
        self
    }

    fn body(&self) -> String {
        // Members of members stand one step further in.
        let lines = self.members.iter().map(|member| format!("  {}", member.replace('\n', "\n  ")));
        format!("{{\n{}\n}}", lines.collect::<Vec<_>>().join(",\n"))
    }

    /// The whole document.
    pub(super) fn document(self) -> String {
        self.body() + "\n"
    }
}

/// A text in quotes.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            c if c < ' ' => out.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_in_objects() {
        let inner = Object::default().text("a\"b", "c\\d\n\u{1}");
        let text =
            Object::default().count("n", 3).object("o", &inner).number("x", f64::NAN).document();
        let expected = "{\n  \"n\": 3,\n  \"o\": {\n    \"a\\\"b\": \"c\\\\d\\n\\u0001\"\n  },\n  \"x\": null\n}\n";
        assert_eq!(text, expected);
    }
}
