//! What a form of the settings is made of is all there.

use serde_json::Value;

use super::Settings;

/// A schema's own entry, or where it says only what it refers to, that.
fn resolved<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    match schema.get("$ref").and_then(Value::as_str) {
        Some(reference) => root.pointer(reference.trim_start_matches('#')).expect("references lead somewhere"),
        None => schema,
    }
}

fn is_described(schema: &Value) -> bool {
    schema.get("description").and_then(Value::as_str).is_some_and(|text| !text.trim().is_empty())
}

/// Keys of a group's leaves that were seen; each of the group's keys must be there, with its documentation.
fn check(root: &Value, group: &Value, tree: &toml::Table, prefix: &str, leaves: &mut Vec<String>) {
    let known = group["properties"].as_object().expect("a group has properties");
    assert_eq!(known.len(), tree.len(), "{prefix} has other keys in its schema");
    for (name, value) in tree {
        let key = format!("{prefix}{name}");
        let entry = known.get(name).unwrap_or_else(|| panic!("{key} is not in the schema"));
        assert!(is_described(entry), "{key} has no documentation");
        let entry = resolved(root, entry);
        if let toml::Value::Table(tree) = value {
            check(root, entry, tree, &format!("{key}."), leaves);
            continue;
        }
        leaves.push(key.clone());
        if let Some(choices) = entry.get("oneOf").and_then(Value::as_array) {
            let names: Vec<_> = choices.iter().filter_map(|choice| choice["const"].as_str()).collect();
            assert_eq!(names.len(), choices.len(), "{key}: {entry}");
            assert!(value.as_str().is_some_and(|value| names.contains(&value)), "{key} is {value}, not of {names:?}");
            assert!(choices.iter().all(is_described), "{key}: {entry}");
        } else {
            assert!(entry.get("type").is_some(), "{key} has no kind: {entry}");
        }
    }
}

#[test]
fn every_setting_has_a_kind_and_documentation_and_so_has_every_choice() {
    let schema = schemars::schema_for!(Settings);
    let root = schema.as_value();
    let tree = toml::Table::try_from(Settings::default()).unwrap();
    let mut leaves = Vec::new();
    check(root, root, &tree, "", &mut leaves);
    for key in ["mode", "map.distance", "tracker.kind", "map.dense.size", "tracker.composite.trackers"] {
        assert!(leaves.iter().any(|leaf| leaf == key), "{key} of {leaves:?}");
    }
}
