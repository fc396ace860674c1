//! Elements of settings, and the texts in them.

use roxmltree::Node;

use crate::bytes::is_printable;

/// Longest label in characters; longer ones are cut off.
const LABEL_CHARS_MAX: usize = 128;

/// Colours of labels, one after the other: red, green, blue, yellow, in the documents' order of bits.
pub(super) const COLOURS: [u32; 4] = [0x0000_00FF, 0x0000_FF00, 0x00FF_0000, 0x0000_FFFF];

pub(super) fn children<'a, 'input>(
    parent: Node<'a, 'input>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'input>> {
    parent.children().filter(move |node| node.tag_name().name() == name)
}

pub(super) fn child<'a, 'input>(
    parent: Node<'a, 'input>,
    name: &'static str,
) -> Option<Node<'a, 'input>> {
    children(parent, name).next()
}

pub(super) fn text_of<'a>(parent: Node<'a, '_>, name: &'static str) -> Option<&'a str> {
    Some(child(parent, name)?.text().unwrap_or_default().trim())
}

/// A text of QTM's as a label: not too long, and without control characters.
pub(super) fn label_text(text: &str) -> String {
    text.trim().chars().filter(|c| is_printable(*c)).take(LABEL_CHARS_MAX).collect()
}

/// Appends an element with text, indented so deep.
pub(super) fn put(xml: &mut String, depth: usize, name: &str, text: &str) {
    xml.push_str(&format!("{:1$}<{name}>", "", 4 * depth));
    for c in text.chars() {
        match c {
            '&' => xml.push_str("&amp;"),
            '<' => xml.push_str("&lt;"),
            '>' => xml.push_str("&gt;"),
            // XML has no way to write them.
            c if !is_printable(c) => xml.push('_'),
            c => xml.push(c),
        }
    }
    xml.push_str(&format!("</{name}>\n"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_text_is_well_formed_and_keeps_what_xml_allows() {
        let text = "a\u{0}\u{1b}\t<&>\u{fffd}\u{fffe}\u{ffff}\u{1fffe}\u{10ffff}\u{85}z";
        let mut xml = String::new();
        put(&mut xml, 0, "Name", text);
        let document = roxmltree::Document::parse(&xml).unwrap();
        let read = document.root_element().text().unwrap();
        assert_eq!(read, "a___<&>\u{fffd}__\u{1fffe}\u{10ffff}_z");
    }
}
