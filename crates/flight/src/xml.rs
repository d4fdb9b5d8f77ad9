//! XML as a tree: MicMac's files are small, and the same names mean different things in different places.

use std::path::Path;

use quick_xml::Reader;
use quick_xml::events::Event;

use crate::error::{Error, Result, read_text};

/// An element: its name, its own text, what is inside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Element {
    pub name: String,
    pub text: String,
    pub children: Vec<Element>,
}

/// Deeper nesting is no file of MicMac's.
const DEEPEST: usize = 64;

impl Element {
    /// What a file holds, in an element without a name.
    ///
    /// # Errors
    /// When the file cannot be read as text; and those of [`Element::parse`].
    pub fn read(path: &Path) -> Result<Element> {
        Element::parse(path, &read_text(path)?)
    }

    /// What a text holds, in an element without a name; `path` is for messages.
    ///
    /// # Errors
    /// When the XML is broken, elements are nested too deep, one ends that never began, or one never ends.
    pub fn parse(path: &Path, text: &str) -> Result<Element> {
        let mut reader = Reader::from_str(text);
        let mut stack = vec![Element::default()];
        let row = |at: u64| format!("row {}", text.bytes().take(at as usize).filter(|b| *b == b'\n').count() + 1);
        loop {
            let event = reader.read_event();
            let place = row(reader.buffer_position());
            let event = event
                .map_err(|e| Error::format(path, row(reader.error_position()), format!("the XML is broken: {e}")))?;
            match event {
                Event::Start(start) => {
                    if stack.len() > DEEPEST {
                        return Err(Error::format(path, place, "elements are nested too deep"));
                    }
                    stack.push(Element { name: start.name().as_ref().to_string(), ..Element::default() });
                }
                Event::Empty(start) => {
                    let child = Element { name: start.name().as_ref().to_string(), ..Element::default() };
                    if let Some(parent) = stack.last_mut() {
                        parent.children.push(child);
                    }
                }
                Event::Text(content) => {
                    let content = quick_xml::escape::unescape(content.as_ref()).unwrap_or_default().into_owned();
                    if let Some(top) = stack.last_mut() {
                        top.text += &content;
                    }
                }
                // `&amp;` and the like come between two texts.
                Event::GeneralRef(entity) => {
                    let entity = format!("&{};", entity.as_ref());
                    if let Some(top) = stack.last_mut() {
                        top.text += &quick_xml::escape::unescape(&entity).unwrap_or_default();
                    }
                }
                Event::End(_) => {
                    if let Some(done) = stack.pop() {
                        match stack.last_mut() {
                            Some(parent) => parent.children.push(done),
                            None => return Err(Error::format(path, place, "an element ends that never began")),
                        }
                    }
                }
                Event::Eof => break,
                _ => {}
            }
        }
        if stack.len() != 1 {
            return Err(Error::format(path, "the end", "the XML stops inside an element; is the file whole?"));
        }
        Ok(stack.remove(0))
    }

    /// The first child of that name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|c| c.name == name)
    }

    /// The first element of that name at any depth, outer ones first.
    pub fn find(&self, name: &str) -> Option<&Element> {
        self.child(name).or_else(|| self.children.iter().find_map(|c| c.find(name)))
    }

    /// Brings all elements of that name, at any depth, into `into`.
    pub fn all<'a>(&'a self, name: &str, into: &mut Vec<&'a Element>) {
        for child in &self.children {
            if child.name == name {
                into.push(child);
            }
            child.all(name, into);
        }
    }

    /// Text without blanks around it and without MMVII's quotes.
    pub fn word(&self) -> &str {
        self.text.trim().trim_matches('"')
    }

    /// Its text as numbers between spaces; `None` when one is none.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        self.text.split_whitespace().map(|w| w.parse().ok().filter(|v: &f64| v.is_finite())).collect()
    }
}

/// `N` numbers of the element `name` below `parent`.
pub(crate) fn numbers<const N: usize>(path: &Path, parent: &Element, name: &str) -> Result<[f64; N]> {
    let element = parent
        .find(name)
        .ok_or_else(|| Error::format(path, format!("<{}>", parent.name), format!("there is no <{name}>")))?;
    element.numbers().and_then(|n| <[f64; N]>::try_from(n).ok()).ok_or_else(|| {
        Error::format(path, format!("<{name}>"), format!("`{}`: {N} numbers are expected", element.text.trim()))
    })
}
