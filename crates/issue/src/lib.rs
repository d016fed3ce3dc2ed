#![doc = include_str!("../README.md")]

mod kind;
mod log;

use std::fmt;
use std::sync::Arc;

use portolan_geometry::Time;
use serde::ser::{Serialize, SerializeMap, SerializeStruct, Serializer};

pub use kind::IssueKind;
pub use log::IssueLog;

/// Severity of an issue or a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// For information; no data are missing.
    Info,
    /// The result may be worse than it could be.
    Warning,
    /// Data are lost, or the result will be wrong.
    Error,
}

impl Severity {
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// A datum of an issue: text, or a number as it is printed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Datum {
    /// A name, a path, a reason.
    Text(String),
    /// A number, formatted with its significant digits.
    Number(String),
}

impl fmt::Display for Datum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) | Self::Number(text) => f.write_str(text),
        }
    }
}

impl Serialize for Datum {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Text(text) => serializer.serialize_str(text),
            Self::Number(text) => match (text.parse::<i64>(), text.parse::<f64>()) {
                (Ok(whole), _) => serializer.serialize_i64(whole),
                (_, Ok(number)) if number.is_finite() => serializer.serialize_f64(number),
                _ => serializer.serialize_str(text),
            },
        }
    }
}

/// A fault of the data that was repaired or left out. Its `Display` is one sentence, which begins with the sensor if
/// there is one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Issue {
    /// Kind of the issue.
    pub kind: IssueKind,
    /// Severity; by default that of the kind.
    pub severity: Severity,
    /// Topic, name of the sensor, or file.
    pub sensor: Option<Arc<str>>,
    /// Names and values of the placeholders of the text.
    pub data: Vec<(&'static str, Datum)>,
    /// Number of occurrences.
    pub count: u64,
    /// Times of the first and the last occurrence; none if unknown.
    pub span: Option<(Time, Time)>,
}

impl Issue {
    /// One occurrence of a kind.
    pub fn new(kind: IssueKind) -> Self {
        Self { kind, severity: kind.severity(), sensor: None, data: Vec::new(), count: 1, span: None }
    }

    /// Sets the topic or sensor.
    #[must_use]
    pub fn of(self, sensor: impl Into<Arc<str>>) -> Self {
        Self { sensor: Some(sensor.into()), ..self }
    }

    /// Sets a severity other than that of the kind.
    #[must_use]
    pub fn with_severity(self, severity: Severity) -> Self {
        Self { severity, ..self }
    }

    /// Adds a text datum.
    #[must_use]
    pub fn with(mut self, name: &'static str, text: impl fmt::Display) -> Self {
        self.data.push((name, Datum::Text(text.to_string())));
        self
    }

    /// Adds a number datum, formatted as it is to be printed.
    #[must_use]
    pub fn with_number(mut self, name: &'static str, number: impl fmt::Display) -> Self {
        self.data.push((name, Datum::Number(number.to_string())));
        self
    }

    /// Sets the number of occurrences.
    #[must_use]
    pub fn times(self, count: u64) -> Self {
        Self { count, ..self }
    }

    /// Sets the time of the occurrence.
    #[must_use]
    pub fn at(self, time: Time) -> Self {
        Self { span: Some((time, time)), ..self }
    }

    /// Sets the times of the first and the last occurrence.
    #[must_use]
    pub fn between(self, from: Time, to: Time) -> Self {
        Self { span: Some((from, to)), ..self }
    }

    /// Whether data were lost: the severity is [`Severity::Error`].
    pub fn lost_data(&self) -> bool {
        self.severity == Severity::Error
    }

    /// The sentence of the issue without the sensor; placeholders are replaced by the data.
    pub fn text(&self) -> String {
        let mut text = self.kind.text().to_owned();
        for (name, datum) in &self.data {
            text = text.replace(&format!("{{{name}}}"), &datum.to_string());
        }
        text
    }
}

impl From<IssueKind> for Issue {
    fn from(kind: IssueKind) -> Self {
        Self::new(kind)
    }
}

impl fmt::Display for Issue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(sensor) = &self.sensor {
            write!(f, "{sensor}: ")?;
        }
        f.write_str(&self.text())
    }
}

/// The data as a JSON object.
struct Data<'a>(&'a [(&'static str, Datum)]);

impl Serialize for Data<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, datum) in self.0 {
            map.serialize_entry(name, datum)?;
        }
        map.end()
    }
}

/// Fields: `kind`, `severity`, `sensor`, `from_s` and `to_s` (Unix seconds, or null), `count`, `data`, `text`.
impl Serialize for Issue {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct("Issue", 8)?;
        fields.serialize_field("kind", &self.kind)?;
        fields.serialize_field("severity", &self.severity)?;
        fields.serialize_field("sensor", &self.sensor.as_deref())?;
        fields.serialize_field("from_s", &self.span.map(|(from, _)| from.unix_seconds()))?;
        fields.serialize_field("to_s", &self.span.map(|(_, to)| to.unix_seconds()))?;
        fields.serialize_field("count", &self.count)?;
        fields.serialize_field("data", &Data(&self.data))?;
        fields.serialize_field("text", &self.to_string())?;
        fields.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_hold_the_data_and_reports_the_kinds() {
        let issue = Issue::new(IssueKind::SensorSilent)
            .of("/scan")
            .with_number("seconds", format_args!("{:.1}", 30.0))
            .at(Time::from_unix_seconds(12.5));
        assert_eq!(
            issue.to_string(),
            "/scan: falls silent 30.0 s before the end; the rest is mapped without it"
        );
        let json = serde_json::to_value(&issue).unwrap();
        assert_eq!((&json["kind"], &json["severity"]), (&"sensor_silent".into(), &"warning".into()));
        assert_eq!((&json["sensor"], &json["from_s"]), (&"/scan".into(), &12.5.into()));
        assert_eq!((&json["count"], &json["data"]["seconds"]), (&1.into(), &30.0.into()));
    }
}
