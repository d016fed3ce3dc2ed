//! Checks limits of an XML document before it is given to a parser.
//!
//! Parsers compare each attribute of an element with all others, resolve the name spaces in scope of each element, and
//! descend into elements by recursion: an element with 100,000 attributes takes minutes, and a document nested 100,000
//! deep overflows the stack.

use std::fmt;

/// Limits of a document.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct XmlLimits {
    /// Maximum size, bytes.
    pub bytes: usize,
    /// Maximum number of attributes of one element.
    pub attributes: usize,
    /// Maximum nesting depth of elements.
    pub depth: usize,
    /// Maximum number of name space declarations in the document.
    pub name_spaces: usize,
}

impl Default for XmlLimits {
    fn default() -> Self {
        Self { bytes: 64 << 20, attributes: 256, depth: 128, name_spaces: 1024 }
    }
}

/// Reason why a document is not given to a parser.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum XmlProblem {
    /// More bytes than this.
    Bytes(usize),
    /// An element with more attributes than this.
    Attributes(usize),
    /// Elements nested deeper than this.
    Depth(usize),
    /// More name spaces than this.
    NameSpaces(usize),
    /// A document type declaration (DOCTYPE), which may define entities that expand without bound.
    DocumentType,
}

impl fmt::Display for XmlProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bytes(limit) => write!(f, "its XML is larger than {} MiB", limit >> 20),
            Self::Attributes(limit) => write!(f, "its XML has an element with more than {limit} attributes"),
            Self::Depth(limit) => write!(f, "its XML is nested deeper than {limit} elements"),
            Self::NameSpaces(limit) => write!(f, "its XML declares more than {limit} name spaces"),
            Self::DocumentType => write!(f, "its XML declares a document type (DOCTYPE), which is not read"),
        }
    }
}

impl std::error::Error for XmlProblem {}

/// Checks a document in one pass, in time linear in its size. It does not check whether the document is well formed;
/// the parser does.
///
/// # Errors
/// The first limit that the document exceeds.
pub fn check_xml(document: &[u8], limits: XmlLimits) -> Result<(), XmlProblem> {
    if document.len() > limits.bytes {
        return Err(XmlProblem::Bytes(limits.bytes));
    }
    let (mut rest, mut depth, mut name_spaces) = (document, 0_usize, 0_usize);
    while let Some(start) = rest.iter().position(|byte| *byte == b'<') {
        rest = rest.get(start..).unwrap_or_default();
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")]
            .into_iter()
            .find(|(opening, _)| rest.starts_with(opening.as_bytes()));
        if let Some((_, closing)) = skipped {
            rest = behind(rest, closing.as_bytes());
        } else if rest.starts_with(b"<!") {
            return Err(XmlProblem::DocumentType);
        } else if rest.starts_with(b"</") {
            depth = depth.saturating_sub(1);
            rest = behind(rest, b">");
        } else {
            let tag = Tag::read(rest);
            name_spaces += tag.name_spaces;
            depth += usize::from(!tag.is_empty);
            if tag.attributes > limits.attributes {
                return Err(XmlProblem::Attributes(limits.attributes));
            }
            if name_spaces > limits.name_spaces {
                return Err(XmlProblem::NameSpaces(limits.name_spaces));
            }
            if depth > limits.depth {
                return Err(XmlProblem::Depth(limits.depth));
            }
            rest = rest.get(tag.length..).unwrap_or_default();
        }
    }
    Ok(())
}

/// Text after the next `closing`; empty if there is none.
fn behind<'a>(text: &'a [u8], closing: &[u8]) -> &'a [u8] {
    let at = text.windows(closing.len()).position(|window| window == closing);
    at.and_then(|at| text.get(at + closing.len()..)).unwrap_or_default()
}

/// Start tag of an element.
#[derive(Default)]
struct Tag {
    /// Bytes up to and including the `>`.
    length: usize,
    attributes: usize,
    name_spaces: usize,
    /// Whether it ends with `/>`.
    is_empty: bool,
}

impl Tag {
    fn read(text: &[u8]) -> Self {
        let mut tag = Self { length: text.len(), ..Self::default() };
        let (mut quote, mut word_start, mut last) = (None, 0, b' ');
        for (index, byte) in text.iter().enumerate() {
            match (quote, *byte) {
                (Some(open), byte) if byte == open => quote = None,
                (Some(_), _) => {}
                (None, b'"' | b'\'') => quote = Some(*byte),
                (None, b'=') => {
                    tag.attributes += 1;
                    let name = text.get(word_start..index).unwrap_or_default();
                    tag.name_spaces += usize::from(name.starts_with(b"xmlns"));
                }
                (None, b'>') => {
                    tag.is_empty = last == b'/';
                    tag.length = index + 1;
                    break;
                }
                (None, _) if last.is_ascii_whitespace() || last == b'"' || last == b'\'' => {
                    word_start = index;
                }
                _ => {}
            }
            last = *byte;
        }
        tag
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn check(document: &str) -> Result<(), XmlProblem> {
        check_xml(document.as_bytes(), XmlLimits::default())
    }

    #[test]
    fn usual_documents_pass() {
        let text = "<?xml version='1.0'?><!-- a <b> --><a xmlns='u' x=\"1 > 2\"><b/><c y='='>t</c><![CDATA[<<<]]></a>";
        assert_eq!(check(text), Ok(()));
        assert_eq!(check(""), Ok(()));
        assert_eq!(check("no markup, and <an unclosed tag"), Ok(()));
        let siblings = format!("<a>{}</a>", "<b c='d'/><e></e>".repeat(10_000));
        assert_eq!(check(&siblings), Ok(()));
    }

    #[test]
    fn documents_that_take_a_parser_long_are_refused() {
        let attributes: String = (0..300).map(|i| format!(" a{i}='<'")).collect();
        assert_eq!(check(&format!("<e{attributes}/>")), Err(XmlProblem::Attributes(256)));
        assert_eq!(check(&"<e>".repeat(200)), Err(XmlProblem::Depth(128)));
        let name_spaces = "<e xmlns:a='b'/>".repeat(2000);
        assert_eq!(check(&format!("<e>{name_spaces}</e>")), Err(XmlProblem::NameSpaces(1024)));
        assert_eq!(check("<!DOCTYPE a [<!ENTITY b 'c'>]><a/>"), Err(XmlProblem::DocumentType));
        let small = XmlLimits { bytes: 3, ..XmlLimits::default() };
        assert_eq!(check_xml(b"<e/>", small), Err(XmlProblem::Bytes(3)));
    }
}
