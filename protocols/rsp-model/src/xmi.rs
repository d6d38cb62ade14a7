//! Models drawn in UML, from XMI as Eclipse UML2 writes it (S4): one class is the robot, its attributes are the elements in
//! the order of the device map, and stereotypes or tags say what a TOML file says with keys.

use std::collections::HashMap;
use std::ops::Range;

use mom_toml_faults::{At, Item, Section, quoted, unknown};
use roxmltree::{Attribute, Document, Node, ParsingOptions};

use crate::fault::{Fault, Found};
use crate::model::{KINDS, MOST_ELEMENTS};
use crate::text::{Source, check_length};

/// The stereotype of the class.
const ROBOT: &str = "robot";
/// The source of annotations whose details are tags.
const TAGS: &str = "rsp";
/// A model has 256 elements with a dozen tags each.
const MOST_NODES: u32 = 1 << 16;
/// More than there are.
const MOST_KEYS: usize = 64;
/// What a class may have beside attributes.
const BESIDE: &[&str] = &["ownedComment", "eAnnotations"];

/// The sections of an XMI file.
pub(crate) fn source(text: &str) -> Result<Source, Found> {
    check_length(text)?;
    // Without DTDs there are no entities but XML's own five, so nothing grows.
    let options = ParsingOptions {
        allow_dtd: false,
        nodes_limit: MOST_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options).map_err(|error| {
        let at = offset(text, error.pos());
        Found::new(Fault::Syntax, &(at..at), without_place(&error.to_string()))
    })?;
    let file = File::new(&document)?;
    let class = file.class()?;
    file.source(class)
}

/// The byte at a line and a column of the parser's, which counts both from 1.
fn offset(text: &str, at: roxmltree::TextPos) -> usize {
    let before: usize = text
        .split_inclusive('\n')
        .take((at.row as usize).saturating_sub(1))
        .map(str::len)
        .sum();
    let line = text.get(before..).unwrap_or_default();
    let within = line.char_indices().nth((at.col as usize).saturating_sub(1));
    before + within.map_or(line.len(), |(at, _)| at)
}

/// The parser's words end in `at 3:14`, which its position says already.
fn without_place(words: &str) -> String {
    let is_place = |place: &str| place.chars().all(|c| c.is_ascii_digit() || c == ':');
    match words.rsplit_once(" at ") {
        Some((words, place)) if is_place(place) => words.to_owned(),
        _ => words.to_owned(),
    }
}

fn beyond(span: &Range<usize>, words: impl Into<String>) -> Found {
    Found::new(Fault::Xmi, span, words)
}

/// Where an element's tag begins.
fn begin(node: Node<'_, '_>) -> Range<usize> {
    let start = node.range().start;
    start..start
}

/// An attribute of the namespace of XMI, which has several versions.
fn xmi<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Attribute<'a, 'i>> {
    node.attributes().find(|attribute| {
        attribute.name() == name && attribute.namespace().is_some_and(|space| space.contains("/XMI"))
    })
}

fn plain<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Attribute<'a, 'i>> {
    node.attributes()
        .find(|attribute| attribute.name() == name && attribute.namespace().is_none())
}

fn children<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children()
        .filter(move |child| child.is_element() && child.tag_name().name() == name)
}

struct File<'a, 'i> {
    model: Node<'a, 'i>,
    /// Applications of stereotypes, which stand beside the model: by the ids that they are applied to.
    applications: HashMap<&'a str, Node<'a, 'i>>,
}

impl<'a, 'i> File<'a, 'i> {
    fn new(document: &'a Document<'i>) -> Result<File<'a, 'i>, Found> {
        let root = document.root_element();
        let is_model = |node: Node<'_, '_>| {
            let space = node.tag_name().namespace().unwrap_or_default();
            node.tag_name().name() == "Model" && space.contains("UML")
        };
        if is_model(root) {
            return Ok(File {
                model: root,
                applications: HashMap::new(),
            });
        }
        if root.tag_name().name() != "XMI" {
            let words = format!(
                "this is not XMI: `xmi:XMI` or `uml:Model` is expected, and there is `{}`",
                quoted(root.tag_name().name())
            );
            return Err(beyond(&begin(root), words));
        }
        let (models, applications): (Vec<_>, Vec<_>) = root
            .children()
            .filter(Node::is_element)
            .partition(|node| is_model(*node));
        let base = |node: &Node<'a, 'i>| {
            let base = node
                .attribute("base_Class")
                .or_else(|| node.attribute("base_Property"))?;
            Some((base, *node))
        };
        let applications: HashMap<&'a str, Node<'a, 'i>> = applications.iter().filter_map(base).collect();
        match models.as_slice() {
            [model] => Ok(File {
                model: *model,
                applications,
            }),
            [] => Err(beyond(&begin(root), "there is no `uml:Model` in `xmi:XMI`")),
            [_, second, ..] => Err(beyond(&begin(*second), "there are two `uml:Model`: one is read")),
        }
    }

    /// The class of the robot: the only one with the stereotype `Robot` or a tag `id`.
    fn class(&self) -> Result<Node<'a, 'i>, Found> {
        let is_class = |node: &Node<'_, '_>| {
            node.tag_name().name() == "packagedElement"
                && xmi(*node, "type").is_some_and(|kind| kind.value() == "uml:Class")
        };
        let is_robot = |node: &Node<'a, 'i>| {
            self.application(*node)
                .is_some_and(|application| word(application.tag_name().name()) == ROBOT)
                || tags(*node).any(|(key, _)| key.value() == "id")
        };
        let mut robots = self
            .model
            .descendants()
            .filter(|node| is_class(node) && is_robot(node));
        let words = "no class has the stereotype `Robot` or a tag `id`: it is the robot, and its attributes are the elements";
        let robot = robots.next().ok_or_else(|| beyond(&begin(self.model), words))?;
        match robots.next() {
            Some(second) => Err(beyond(
                &begin(second),
                "this is the second robot: a model has one",
            )),
            None => Ok(robot),
        }
    }

    /// The stereotype that is applied to something.
    fn application(&self, of: Node<'_, '_>) -> Option<Node<'a, 'i>> {
        self.applications.get(xmi(of, "id")?.value()).copied()
    }

    fn source(&self, class: Node<'a, 'i>) -> Result<Source, Found> {
        let foreign = class.children().filter(Node::is_element).find(|child| {
            let name = child.tag_name().name();
            name != "ownedAttribute" && !BESIDE.contains(&name)
        });
        if let Some(child) = foreign {
            let words = format!(
                "`{}` is outside the part of XMI that is read: the robot's class has attributes and comments alone",
                quoted(child.tag_name().name())
            );
            return Err(beyond(&begin(child), words));
        }
        let attributes: Vec<Node<'a, 'i>> = children(class, "ownedAttribute").collect();
        if let Some(beyond) = attributes.get(MOST_ELEMENTS) {
            let words = format!(
                "{} attributes are too many: a model has at most {MOST_ELEMENTS} elements",
                attributes.len()
            );
            return Err(Found::new(Fault::Elements, &begin(*beyond), words));
        }
        let mut root = section(class)?;
        if let Some(application) = self.application(class) {
            stereotype(application, &mut root, &attributes)?;
        }
        tagged(class, &mut root, &attributes)?;
        let elements = attributes
            .iter()
            .map(|attribute| self.element(*attribute, &attributes))
            .collect::<Result<_, _>>()?;
        Ok(Source { root, elements })
    }

    fn element(&self, attribute: Node<'a, 'i>, all: &[Node<'a, 'i>]) -> Result<Section, Found> {
        let mut section = section(attribute)?;
        if let Some(application) = self.application(attribute) {
            let name = application.tag_name().name();
            let kind = word(name);
            let kinds: Vec<&str> = KINDS.iter().map(|(word, _)| *word).collect();
            if !kinds.contains(&kind.as_str()) {
                return Err(Found::new(
                    Fault::UnknownWord,
                    &begin(application),
                    unknown("stereotype", &kind, &kinds),
                ));
            }
            add(
                &mut section,
                "kind",
                begin(application),
                Item::Raw(kind),
                begin(application),
            )?;
            stereotype(application, &mut section, all)?;
        }
        tagged(attribute, &mut section, all)?;
        if !section.entries.iter().any(|(key, _)| key.value == "kind") {
            let name = plain(attribute, "name").map_or("", |name| name.value());
            let words = format!(
                "`{}` has no kind: give it a stereotype such as `Effector`, or a tag `kind`",
                quoted(name)
            );
            return Err(beyond(&begin(attribute), words));
        }
        Ok(section)
    }
}

/// The name and the comments of a class or an attribute.
fn section(node: Node<'_, '_>) -> Result<Section, Found> {
    let mut section = Section {
        span: begin(node),
        entries: Vec::new(),
    };
    if let Some(name) = plain(node, "name") {
        let value = Item::Raw(word(name.value()));
        add(
            &mut section,
            "name",
            name.range_qname(),
            value,
            name.range_value(),
        )?;
    }
    let bodies: Vec<Node<'_, '_>> = children(node, "ownedComment")
        .flat_map(|comment| children(comment, "body"))
        .collect();
    if let Some(first) = bodies.first() {
        let texts = bodies.iter().filter_map(Node::text).map(str::trim);
        let doc = texts.collect::<Vec<_>>().join("\n");
        add(&mut section, "doc", begin(*first), Item::Raw(doc), begin(*first))?;
    }
    Ok(section)
}

/// What a stereotype says: attributes, and children where there are several values.
fn stereotype(application: Node<'_, '_>, to: &mut Section, all: &[Node<'_, '_>]) -> Result<(), Found> {
    for attribute in application.attributes() {
        let is_ours = attribute.namespace().is_none() && !attribute.name().starts_with("base_");
        if is_ours {
            let key = word(attribute.name());
            let value = referred(&key, attribute.value(), all);
            add(to, &key, attribute.range_qname(), value, attribute.range_value())?;
        }
    }
    let mut children: Vec<(String, Vec<At<Item>>)> = Vec::new();
    for child in application.children().filter(Node::is_element) {
        let key = word(child.tag_name().name());
        let at = At {
            value: referred(&key, child.text().unwrap_or_default().trim(), all),
            span: begin(child),
        };
        if let Some((_, values)) = children.iter_mut().find(|(known, _)| *known == key) {
            values.push(at);
        } else if children.len() < MOST_KEYS {
            children.push((key, vec![at]));
        } else {
            return Err(beyond(&at.span, "there is no element with so many tags"));
        }
    }
    for (key, values) in children {
        let span = values.first().map_or(0..0, |first| first.span.clone());
        let value = match <[At<Item>; 1]>::try_from(values) {
            Ok([only]) => only.value,
            Err(values) => Item::List(values),
        };
        add(to, &key, span.clone(), value, span)?;
    }
    Ok(())
}

/// The tags of a node: details of its annotations of our source.
fn tags<'a, 'i>(node: Node<'a, 'i>) -> impl Iterator<Item = (Attribute<'a, 'i>, Option<Attribute<'a, 'i>>)> {
    children(node, "eAnnotations")
        .filter(|annotation| plain(*annotation, "source").is_some_and(|source| source.value() == TAGS))
        .flat_map(|annotation| children(annotation, "details"))
        .filter_map(|detail| Some((plain(detail, "key")?, plain(detail, "value"))))
}

fn tagged(node: Node<'_, '_>, to: &mut Section, all: &[Node<'_, '_>]) -> Result<(), Found> {
    for (key, value) in tags(node) {
        let name = word(key.value());
        let text = value.map_or("", |value| value.value());
        let span = value.map_or_else(|| key.range_value(), |value| value.range_value());
        add(to, &name, key.range_value(), referred(&name, text, all), span)?;
    }
    Ok(())
}

fn add(
    to: &mut Section,
    key: &str,
    key_span: Range<usize>,
    value: Item,
    span: Range<usize>,
) -> Result<(), Found> {
    if to.entries.iter().any(|(known, _)| known.value == key) {
        return Err(beyond(&key_span, format!("`{}` is said twice", quoted(key))));
    }
    if to.entries.len() == MOST_KEYS {
        return Err(beyond(&key_span, "there is no element with so many tags"));
    }
    let key = At {
        value: key.to_owned(),
        span: key_span,
    };
    to.entries.push((key, At { value, span }));
    Ok(())
}

/// The value of a key; where it refers to elements, ids become the names that they stand for.
fn referred(key: &str, value: &str, all: &[Node<'_, '_>]) -> Item {
    if !matches!(key, "of" | "members") {
        return Item::Raw(value.to_owned());
    }
    let name = |reference: &str| {
        let node = all
            .iter()
            .find(|node| xmi(**node, "id").is_some_and(|id| id.value() == reference));
        let name = node.and_then(|node| plain(*node, "name"));
        name.map_or_else(|| reference.to_owned(), |name| word(name.value()))
    };
    Item::Raw(value.split_whitespace().map(name).collect::<Vec<_>>().join(" "))
}

/// A name as models write it: `leftWheel`, `LeftWheel`, `left_wheel` and `Left Wheel` are all `left-wheel`.
fn word(name: &str) -> String {
    let mut word = String::new();
    let mut before_is_small = false;
    for c in name.chars() {
        if c.is_ascii_uppercase() && before_is_small {
            word.push('-');
        }
        before_is_small = c.is_ascii_lowercase() || c.is_ascii_digit();
        match c {
            ' ' | '_' => word.push('-'),
            c => word.push(c.to_ascii_lowercase()),
        }
    }
    word
}
