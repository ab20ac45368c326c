//! The form that settings are edited in, made of their schema: what there is, of which kind, and what its documentation says.

use itm_core::Settings;
use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Value};

/// Hover text of settings that a running session cannot take over.
pub(super) const NEEDS_RESTART: &str = "Takes effect when the recording is started again";

/// A group of settings.
#[derive(Debug)]
pub(super) struct Group {
    pub(super) name: String,
    /// In full, with dots.
    pub(super) key: String,
    pub(super) documentation: String,
    /// In the tree's order.
    pub(super) entries: Vec<Entry>,
}

/// What is in a group.
#[derive(Debug)]
pub(super) enum Entry {
    Group(Group),
    Leaf(Leaf),
}

/// A setting.
#[derive(Debug)]
pub(super) struct Leaf {
    pub(super) name: String,
    /// In full, with dots.
    pub(super) key: String,
    /// Where its value is in the tree.
    pub(super) pointer: String,
    pub(super) documentation: String,
    pub(super) kind: Kind,
    pub(super) default: Value,
    /// Whether a running session takes it over.
    pub(super) is_live: bool,
}

/// What values a setting has.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Kind {
    Switch,
    Number(Number),
    /// So many numbers.
    Numbers(Number, usize),
    Text,
    /// One of several names.
    Choice(Vec<Choice>),
    /// A value or none.
    Optional(Box<Kind>),
    /// Anything else, as TOML.
    Other,
}

/// What numbers a setting has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Number {
    pub(super) whole: bool,
    /// Whether it is kept in single precision.
    pub(super) single: bool,
    pub(super) least: f64,
    pub(super) most: f64,
}

/// A name that a setting may have.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Choice {
    pub(super) name: String,
    pub(super) documentation: String,
}

/// Settings as a tree of values.
pub(super) fn tree_of(settings: &Settings) -> Value {
    // Through text, in which 0.005 in single precision is 0.005, and not the double next to what that is kept as.
    serde_json::from_str(&text_of(settings)).expect("it was just written")
}

fn text_of(settings: &Settings) -> String {
    serde_json::to_string(settings).expect("settings are groups of numbers, strings and switches")
}

/// The form of all settings.
pub(super) fn form() -> Group {
    let defaults = Settings::default();
    let schema = schemars::schema_for!(Settings);
    let order: Order = serde_json::from_str(&text_of(&defaults)).expect("it was just written");
    group("", String::new(), schema.as_value(), schema.as_value(), &order, &tree_of(&defaults))
}

fn group(name: &str, key: String, root: &Value, schema: &Value, order: &Order, defaults: &Value) -> Group {
    let prefix = if key.is_empty() { String::new() } else { format!("{key}.") };
    let entries = order.0.iter().map(|(name, order)| {
        let key = format!("{prefix}{name}");
        let entry = resolved(root, schema).pointer(&format!("/properties/{name}")).unwrap_or(&Value::Null);
        let default = &defaults[name];
        if default.is_object() {
            return Entry::Group(group(name, key, root, entry, order, default));
        }
        Entry::Leaf(Leaf {
            name: name.clone(),
            pointer: format!("/{}", key.replace('.', "/")),
            documentation: documentation(root, entry),
            kind: Kind::of(root, entry),
            default: default.clone(),
            is_live: Settings::is_live(&key),
            key,
        })
    });
    let entries = entries.collect();
    Group { name: name.into(), key, documentation: documentation(root, schema), entries }
}

/// What a schema refers to, where it does.
fn resolved<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    let reference = schema.get("$ref").and_then(Value::as_str).and_then(|reference| reference.strip_prefix('#'));
    reference.and_then(|pointer| root.pointer(pointer)).unwrap_or(schema)
}

/// The documentation of a schema, and of what it refers to where that says more than the same.
fn documentation(root: &Value, schema: &Value) -> String {
    let mut texts: Vec<String> = Vec::new();
    for schema in [schema, resolved(root, schema)] {
        let text = plain(schema.get("description").and_then(Value::as_str).unwrap_or_default());
        if !text.is_empty() && !texts.contains(&text) {
            texts.push(text);
        }
    }
    texts.join("\n\n")
}

/// Documentation as it is to be read: a line a paragraph, without marks of links and emphasis.
fn plain(documentation: &str) -> String {
    let paragraphs = documentation.trim().split("\n\n").map(|paragraph| {
        let words: Vec<&str> = paragraph.split_whitespace().collect();
        words.join(" ").replace("[`", "`").replace("`]", "`").replace('*', "")
    });
    paragraphs.collect::<Vec<_>>().join("\n\n")
}

impl Kind {
    fn of(root: &Value, schema: &Value) -> Self {
        let schema = resolved(root, schema);
        if let Some(types) = schema.get("type").and_then(Value::as_array) {
            let others: Vec<&Value> = types.iter().filter(|of| *of != "null").collect();
            if let ([one], true) = (&others[..], others.len() < types.len()) {
                let mut of_value = schema.clone();
                of_value["type"] = (*one).clone();
                return Self::Optional(Box::new(Self::of(root, &of_value)));
            }
        }
        if let Some(any) = schema.get("anyOf").and_then(Value::as_array) {
            let others: Vec<&Value> = any.iter().filter(|of| of.get("type").is_none_or(|of| of != "null")).collect();
            if let ([one], true) = (&others[..], others.len() < any.len()) {
                return Self::Optional(Box::new(Self::of(root, one)));
            }
        }
        if let Some(choices) = Self::choices(schema) {
            return Self::Choice(choices);
        }
        match schema.get("type").and_then(Value::as_str) {
            Some("boolean") => Self::Switch,
            Some("string") => Self::Text,
            Some("integer" | "number") => Self::Number(Number::of(schema)),
            Some("array") => {
                let count = |limit: &str| schema.get(limit).and_then(Value::as_u64);
                let items = schema.get("items").map(|items| Self::of(root, items));
                match (items, count("minItems"), count("maxItems")) {
                    (Some(Self::Number(number)), Some(least), Some(most)) if least == most => {
                        Self::Numbers(number, least as usize)
                    }
                    _ => Self::Other,
                }
            }
            _ => Self::Other,
        }
    }

    /// Names with their documentation, or without where none has any.
    fn choices(schema: &Value) -> Option<Vec<Choice>> {
        if let Some(names) = schema.get("enum").and_then(Value::as_array) {
            let choice = |name: &Value| Some(Choice { name: name.as_str()?.into(), documentation: String::new() });
            return names.iter().map(choice).collect();
        }
        let mut choices = Vec::new();
        for choice in schema.get("oneOf")?.as_array()? {
            let documentation = plain(choice.get("description").and_then(Value::as_str).unwrap_or_default());
            match choice.get("const").and_then(Value::as_str) {
                Some(name) => choices.push(Choice { name: name.into(), documentation }),
                // Those without documentation stand together.
                None => choices.extend(Self::choices(choice)?),
            }
        }
        Some(choices)
    }

    /// A value to begin with where there was none.
    pub(super) fn first_value(&self) -> Value {
        match self {
            Self::Switch => false.into(),
            Self::Number(number) => number.value(0.0_f64.clamp(number.least, number.most)),
            Self::Numbers(number, count) => vec![number.value(0.0_f64.clamp(number.least, number.most)); *count].into(),
            Self::Text => "".into(),
            Self::Choice(choices) => choices.first().map(|choice| choice.name.clone()).into(),
            Self::Optional(_) | Self::Other => Value::Null,
        }
    }
}

impl Number {
    fn of(schema: &Value) -> Self {
        let format = schema.get("format").and_then(Value::as_str).unwrap_or_default();
        let (least, most) = match format {
            "uint8" => (0.0, u8::MAX.into()),
            "uint16" => (0.0, u16::MAX.into()),
            "uint32" => (0.0, u32::MAX.into()),
            "int8" => (i8::MIN.into(), i8::MAX.into()),
            "int16" => (i16::MIN.into(), i16::MAX.into()),
            "int32" => (i32::MIN.into(), i32::MAX.into()),
            // Beyond these a double leaves whole numbers out.
            "uint64" | "uint" => (0.0, (1_u64 << 53) as f64),
            "int64" | "int" => (-((1_u64 << 53) as f64), (1_u64 << 53) as f64),
            "float" => (f32::MIN.into(), f32::MAX.into()),
            _ => (f64::NEG_INFINITY, f64::INFINITY),
        };
        let limit = |name: &str| schema.get(name).and_then(Value::as_f64);
        Self {
            whole: schema.get("type").is_some_and(|of| of == "integer"),
            single: format == "float",
            least: limit("minimum").map_or(least, |limit| limit.max(least)),
            most: limit("maximum").map_or(most, |limit| limit.min(most)),
        }
    }

    /// As it is written: as short as it can be read back.
    pub(super) fn text(self, value: f64) -> String {
        if self.single { (value as f32).to_string() } else { value.to_string() }
    }

    pub(super) fn value(self, value: f64) -> Value {
        if self.whole {
            return (value.round() as i64).into();
        }
        // In single precision the double that is written as shortly.
        self.text(value).parse().unwrap_or(value).into()
    }
}

impl Leaf {
    /// Its documentation, where it stands, and what it is by default.
    pub(super) fn tooltip(&self) -> String {
        let mut text = format!("{}\n\n{}\nDefault: {}", self.documentation, self.key, as_toml(&self.default));
        if !self.is_live {
            text.push('\n');
            text.push_str(NEEDS_RESTART);
        }
        text
    }

    fn is_found(&self, word: &str) -> bool {
        let choices = if let Kind::Choice(choices) = &self.kind { &choices[..] } else { &[] };
        is_in(word, &self.key) || is_in(word, &self.documentation) || choices.iter().any(|c| is_in(word, &c.name))
    }

    /// Whether every word is in the key or in the documentation.
    pub(super) fn matches(&self, words: &[String]) -> bool {
        words.iter().all(|word| self.is_found(word))
    }
}

impl Group {
    /// Whether every word is in the group's own key or documentation, so that all of it is meant.
    pub(super) fn matches_itself(&self, words: &[String]) -> bool {
        !self.key.is_empty() && words.iter().all(|word| is_in(word, &self.key) || is_in(word, &self.documentation))
    }

    /// Whether the group or anything in it matches.
    pub(super) fn matches(&self, words: &[String]) -> bool {
        self.matches_itself(words)
            || self.entries.iter().any(|entry| match entry {
                Entry::Group(group) => group.matches(words),
                Entry::Leaf(leaf) => leaf.matches(words),
            })
    }
}

/// Whether a word in lower case is in a text.
fn is_in(word: &str, text: &str) -> bool {
    text.to_lowercase().contains(word)
}

/// A value as it stands in a settings file.
pub(super) fn as_toml(value: &Value) -> String {
    toml::Value::try_from(value).map_or_else(|_| "none".into(), |value| value.to_string())
}

/// The part of a tree that differs from another, without what is none.
pub(super) fn difference(tree: &Value, from: &Value) -> Map<String, Value> {
    let mut differing = Map::new();
    for (name, value) in tree.as_object().into_iter().flatten() {
        let before = &from[name];
        if value.is_object() && before.is_object() {
            let within = difference(value, before);
            if !within.is_empty() {
                differing.insert(name.clone(), within.into());
            }
        } else if value != before && !value.is_null() {
            differing.insert(name.clone(), value.clone());
        }
    }
    differing
}

/// Names in the order in which they were written, which a tree of values does not keep.
struct Order(Vec<(String, Order)>);

impl<'de> Deserialize<'de> for Order {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(OrderVisitor)
    }
}

struct OrderVisitor;

impl<'de> Visitor<'de> for OrderVisitor {
    type Value = Order;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a tree")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Order, A::Error> {
        let mut names = Vec::new();
        while let Some(entry) = map.next_entry()? {
            names.push(entry);
        }
        Ok(Order(names))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Order, A::Error> {
        while seq.next_element::<IgnoredAny>()?.is_some() {}
        Ok(Order(Vec::new()))
    }

    fn visit_bool<E>(self, _: bool) -> Result<Order, E> {
        Ok(Order(Vec::new()))
    }

    fn visit_i64<E>(self, _: i64) -> Result<Order, E> {
        Ok(Order(Vec::new()))
    }

    fn visit_u64<E>(self, _: u64) -> Result<Order, E> {
        Ok(Order(Vec::new()))
    }

    fn visit_f64<E>(self, _: f64) -> Result<Order, E> {
        Ok(Order(Vec::new()))
    }

    fn visit_str<E>(self, _: &str) -> Result<Order, E> {
        Ok(Order(Vec::new()))
    }

    fn visit_unit<E>(self) -> Result<Order, E> {
        Ok(Order(Vec::new()))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn leaf<'a>(group: &'a Group, key: &str) -> Option<&'a Leaf> {
        group.entries.iter().find_map(|entry| match entry {
            Entry::Group(group) => leaf(group, key),
            Entry::Leaf(leaf) => (leaf.key == key).then_some(leaf),
        })
    }

    fn all<'a>(group: &'a Group, of: &mut Vec<&'a Leaf>) {
        for entry in &group.entries {
            match entry {
                Entry::Group(group) => all(group, of),
                Entry::Leaf(leaf) => of.push(leaf),
            }
        }
    }

    #[test]
    fn the_form_has_every_setting_in_the_trees_order_with_its_documentation() {
        let form = form();
        let names = form.entries.iter().map(|entry| match entry {
            Entry::Group(group) => group.name.as_str(),
            Entry::Leaf(leaf) => leaf.name.as_str(),
        });
        let expected = ["mode", "device", "view", "map", "tracker", "relocaliser", "submaps", "surfels"];
        assert_eq!(names.collect::<Vec<_>>(), expected);
        let mut leaves = Vec::new();
        all(&form, &mut leaves);
        assert!(leaves.len() > 150, "{}", leaves.len());
        let defaults = tree_of(&Settings::default());
        for leaf in leaves {
            assert!(!leaf.documentation.is_empty(), "{}", leaf.key);
            assert_eq!(defaults.pointer(&leaf.pointer), Some(&leaf.default), "{}", leaf.key);
            assert!(leaf.kind != Kind::Other || leaf.key == "tracker.composite.trackers", "{leaf:?}");
        }
    }

    #[test]
    fn kinds_follow_the_types() {
        let form = form();
        let kind = |key| &leaf(&form, key).expect(key).kind;
        assert_eq!(*kind("map.fuse"), Kind::Switch);
        assert_eq!(*kind("device.adapter"), Kind::Text);
        let number = |key| match kind(key) {
            Kind::Number(number) | Kind::Numbers(number, 3) => *number,
            other => panic!("{key}: {other:?}"),
        };
        assert_eq!(number("map.max_weight"), Number { whole: true, single: false, least: 0.0, most: 65535.0 });
        assert_eq!(number("map.initial_blocks").most, f64::from(u32::MAX));
        assert_eq!(number("map.dense.offset").least, f64::from(i32::MIN));
        assert!(number("map.voxel_size_m").single && !number("submaps.new_below").single);
        let Kind::Choice(choices) = kind("map.distance") else { panic!("{:?}", kind("map.distance")) };
        assert_eq!(choices.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["i16", "f32"]);
        assert!(choices.iter().all(|choice| !choice.documentation.is_empty()));
    }

    #[test]
    fn what_may_be_none_and_names_without_documentation_are_understood() {
        let root = json!({"$defs": {"Of": {"type": "integer", "format": "uint8", "minimum": 1}}});
        let of = |schema: Value| Kind::of(&root, &schema);
        let number = Number { whole: true, single: false, least: 1.0, most: 255.0 };
        assert_eq!(of(json!({"$ref": "#/$defs/Of"})), Kind::Number(number));
        let optional = Kind::Optional(Box::new(Kind::Number(number)));
        assert_eq!(of(json!({"anyOf": [{"$ref": "#/$defs/Of"}, {"type": "null"}]})), optional);
        assert_eq!(of(json!({"type": ["string", "null"]})), Kind::Optional(Box::new(Kind::Text)));
        assert_eq!(Kind::Number(number).first_value(), json!(1));
        let choice = |name: &str, text: &str| Choice { name: name.into(), documentation: text.into() };
        assert_eq!(
            of(json!({"oneOf": [{"enum": ["a", "b"]}, {"const": "c", "description": "The\nthird."}]})),
            Kind::Choice(vec![choice("a", ""), choice("b", ""), choice("c", "The third.")])
        );
        assert_eq!(of(json!({"oneOf": [{"type": "object"}]})), Kind::Other);
        assert_eq!(of(json!({"type": "array", "items": {"type": "string"}})), Kind::Other);
    }

    #[test]
    fn tooltips_say_what_where_and_which_is_the_default() {
        let form = form();
        let tooltip = leaf(&form, "map.voxel_size_m").expect("it is there").tooltip();
        assert_eq!(tooltip, format!("Edge of a voxel in metres.\n\nmap.voxel_size_m\nDefault: 0.005\n{NEEDS_RESTART}"));
        let tooltip = leaf(&form, "tracker.composite.trackers").expect("it is there").tooltip();
        assert!(tooltip.contains("as for `TrackerSettings::set_string`."), "{tooltip}");
        assert!(tooltip.contains(r#"["type=icp,levels=rrnn", "type=extended"]"#), "{tooltip}");
        assert!(!leaf(&form, "map.fuse").expect("it is there").tooltip().contains(NEEDS_RESTART));
    }

    #[test]
    fn numbers_are_as_short_as_they_can_be_read_back() {
        let number = |single| Number { whole: false, single, least: f64::MIN, most: f64::MAX };
        assert_eq!(number(true).value(f64::from(0.005_f32)), json!(0.005));
        assert_eq!(number(false).value(1e-5), json!(1e-5));
        assert_eq!(tree_of(&Settings::default()).pointer("/map/voxel_size_m"), Some(&json!(0.005)));
    }
}
