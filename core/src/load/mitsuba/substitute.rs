//! `$name` in attributes: values from the command line, else from `<default>`.

use std::fmt::Write as _;

/// The longest value that substitution may make. It only keeps a scene from growing without bound: real ones have file
/// names and numbers here.
const SUBSTITUTED_BYTES_MAX: usize = 64 << 10;

/// The names known so far, longest first, so that `$ab` is not taken for `$a` followed by b.
#[derive(Debug, Default)]
pub(crate) struct Definitions(Vec<Definition>);

#[derive(Debug)]
struct Definition {
    name: String,
    value: String,
    /// Whether the scene has this name: a `$name` or a `<default>`.
    known: bool,
}

impl Definitions {
    /// From the command line. They win over the scene's defaults; of two for one name the last wins.
    pub fn new(defines: &[(String, String)]) -> Self {
        let mut definitions = Self::default();
        for (name, value) in defines {
            definitions.0.retain(|definition| definition.name != *name);
            definitions.insert(Definition { name: name.clone(), value: value.clone(), known: false });
        }
        definitions
    }

    fn insert(&mut self, definition: Definition) {
        let at = self.0.partition_point(|known| known.name.len() >= definition.name.len());
        self.0.insert(at, definition);
    }

    /// `<default name value>`: holds if nothing was said before.
    pub fn set_default(&mut self, name: &str, value: &str) {
        match self.0.iter_mut().find(|definition| definition.name == name) {
            Some(definition) => definition.known = true,
            None => self.insert(Definition { name: name.into(), value: value.into(), known: true }),
        }
    }

    /// `text` with values in place of names. `\$` stands for a dollar sign.
    ///
    /// # Errors
    /// A name that has no value, or a result beyond all measure.
    pub fn apply(&mut self, text: &str) -> Result<String, String> {
        let mut text = text.to_owned();
        for definition in &mut self.0 {
            if text.contains('$') {
                definition.known |= definition.replace_in(&mut text)?;
            }
        }
        if let Some(at) = unescaped_dollar(&text) {
            let rest = &text[at + 1..];
            let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
            return Err(self.undefined(&rest[..end]));
        }
        Ok(text.replace("\\$", "$"))
    }

    fn undefined(&self, name: &str) -> String {
        let hint = crate::load::error::did_you_mean(name, self.0.iter().map(|definition| definition.name.as_str()));
        format!(
            "${name} has no value here{hint}; put <default name=\"{name}\" value=\"…\"/> before it, or give -D {name}=…"
        )
    }

    /// A message about a value from the command line that the scene has no use for.
    pub fn unused(&self) -> Option<String> {
        let stray = self.0.iter().find(|definition| !definition.known)?;
        let known: Vec<&str> = self.0.iter().filter(|d| d.known).map(|d| d.name.as_str()).collect();
        let mut message = format!("-D {}: the scene has no ${}", stray.name, stray.name);
        message += &crate::load::error::did_you_mean(&stray.name, known.iter().copied());
        let _ = match known.as_slice() {
            [] => write!(message, "; it has no parameters at all"),
            _ => write!(message, "; it has {}", known.join(", ")),
        };
        Some(message)
    }
}

impl Definition {
    /// Whether it occurred.
    fn replace_in(&self, text: &mut String) -> Result<bool, String> {
        let key = format!("${}", self.name);
        let (mut from, mut found) = (0, false);
        while let Some(at) = text[from..].find(&key).map(|i| from + i) {
            if text[..at].ends_with('\\') {
                from = at + key.len();
                continue;
            }
            if text.len() + self.value.len() > SUBSTITUTED_BYTES_MAX {
                return Err(format!("with the value of ${} this attribute grows beyond all measure", self.name));
            }
            text.replace_range(at..at + key.len(), &self.value);
            from = at + self.value.len();
            found = true;
        }
        Ok(found)
    }
}

fn unescaped_dollar(text: &str) -> Option<usize> {
    text.match_indices('$').map(|(at, _)| at).find(|&at| !text[..at].ends_with('\\'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn definitions(list: &[(&str, &str)]) -> Definitions {
        Definitions::new(&list.iter().map(|(n, v)| (n.to_string(), v.to_string())).collect::<Vec<_>>())
    }

    #[test]
    fn longer_names_come_first_and_escapes_stay() {
        let mut known = definitions(&[("a", "1"), ("ab", "2")]);
        assert_eq!(known.apply("$ab $a x$a.obj \\$a").unwrap(), "2 1 x1.obj $a");
        assert!(known.unused().is_none());
    }

    #[test]
    fn the_command_line_wins_over_defaults_and_the_first_default_over_the_next() {
        let mut known = definitions(&[("spp", "8")]);
        known.set_default("spp", "1");
        known.set_default("res", "64");
        known.set_default("res", "128");
        assert_eq!(known.apply("$spp $res").unwrap(), "8 64");
    }

    #[test]
    fn an_undefined_name_and_an_unused_one_are_errors() {
        let mut known = definitions(&[("ssp", "8")]);
        assert!(known.apply("$width").unwrap_err().contains("$width has no value"));
        known.set_default("spp", "1");
        let message = known.unused().unwrap();
        assert!(message.contains("-D ssp") && message.contains("did you mean 'spp'?"), "{message}");
    }

    #[test]
    fn substitution_cannot_grow_without_bound() {
        let mut known = definitions(&[]);
        known.set_default("x0", "xxxxxxxxxx");
        let mut result = Ok(String::new());
        for i in 0..40 {
            result = known.apply(&format!("$x{i}$x{i}"));
            match &result {
                Ok(value) => known.set_default(&format!("x{}", i + 1), value),
                Err(_) => break,
            }
        }
        assert!(result.unwrap_err().contains("beyond all measure"));
    }
}
