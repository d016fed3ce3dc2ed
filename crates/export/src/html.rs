//! Writes a self-contained HTML page: pictures and plots are embedded.

use std::fmt::Write;

const STYLE: &str = "\
body{font:15px/1.45 system-ui,sans-serif;color:#20252b;background:#fff;margin:0 auto;max-width:1180px;padding:24px}\
h1{font-size:26px;margin:0 0 4px}h2{font-size:19px;margin:34px 0 8px;border-bottom:1px solid #d5d9de;padding-bottom:4px}\
p{margin:6px 0}code{background:#f1f3f5;padding:1px 4px;border-radius:3px;overflow-wrap:anywhere}\
table{border-collapse:collapse;margin:8px 0}td,th{border-bottom:1px solid #e2e5e9;padding:4px 14px 4px 0;text-align:left;vertical-align:top}\
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}\
.row{display:flex;gap:14px;flex-wrap:wrap}figure{flex:1 1 320px;margin:8px 0;min-width:0;break-inside:avoid}\
figure svg{width:100%;height:auto;border:1px solid #d5d9de;display:block}figcaption{font-size:13px;color:#5a636d;margin-top:4px}\
.warn{background:#fff4e0;border-left:4px solid #e08214;padding:6px 12px}\
@media print{body{max-width:none;padding:0;font-size:11px}h2{break-after:avoid}}";

/// Escapes a text for HTML and its attributes.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            c => out.push(c),
        }
    }
    out
}

/// A page that is written from top to bottom.
#[derive(Clone, Debug)]
pub struct HtmlPage {
    html: String,
}

impl HtmlPage {
    /// A page with a title.
    pub fn new(title: &str) -> Self {
        let title = escape(title);
        let html = format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\
             <title>{title}</title><style>{STYLE}</style></head>\n<body><h1>{title}</h1>\n"
        );
        Self { html }
    }

    /// A heading.
    pub fn heading(&mut self, text: &str) {
        let _ = writeln!(self.html, "<h2>{}</h2>", escape(text));
    }

    /// A paragraph.
    pub fn paragraph(&mut self, text: &str) {
        let _ = writeln!(self.html, "<p>{}</p>", escape(text));
    }

    /// A paragraph marked as a warning.
    pub fn warning(&mut self, text: &str) {
        let _ = writeln!(self.html, "<p class=\"warn\">{}</p>", escape(text));
    }

    /// A command line as typed.
    pub fn command(&mut self, text: &str) {
        let _ = writeln!(self.html, "<p><code>{}</code></p>", escape(text));
    }

    /// A table; cells that begin with a digit or a sign are aligned as numbers.
    pub fn table<R: AsRef<[String]>>(&mut self, head: &[&str], rows: &[R]) {
        self.html += "<table>";
        if !head.is_empty() {
            self.html += "<tr>";
            for (i, cell) in head.iter().enumerate() {
                let class = if i == 0 { "" } else { " class=\"n\"" };
                let _ = write!(self.html, "<th{class}>{}</th>", escape(cell));
            }
            self.html += "</tr>";
        }
        for row in rows {
            self.html += "<tr>";
            for (i, cell) in row.as_ref().iter().enumerate() {
                let is_number = i > 0 && cell.starts_with(|c: char| c.is_ascii_digit() || "+-−".contains(c));
                let class = if is_number && !head.is_empty() { " class=\"n\"" } else { "" };
                let _ = write!(self.html, "<td{class}>{}</td>", escape(cell));
            }
            self.html += "</tr>";
        }
        self.html += "</table>\n";
    }

    /// Drawings (SVG) side by side, each with a caption.
    pub fn figures(&mut self, figures: &[(String, String)]) {
        self.html += "<div class=\"row\">";
        for (svg, caption) in figures {
            let _ = write!(self.html, "<figure>{svg}<figcaption>{}</figcaption></figure>", escape(caption));
        }
        self.html += "</div>\n";
    }

    /// The finished page.
    pub fn finish(self) -> String {
        self.html + "</body></html>\n"
    }
}

/// A mark drawn over a picture, in its pixels.
#[derive(Clone, Debug, PartialEq)]
pub enum Mark {
    /// A frame with a label: left, top, width, height.
    Frame([f64; 4], String),
    /// A line.
    Line(Vec<[f64; 2]>),
    /// A bar of this length in pixels, with its length as text, below the picture.
    Scale(f64, String),
}

/// A PNG picture as SVG, with marks drawn over it.
pub fn marked_picture(png: &[u8], width: usize, height: usize, marks: &[Mark]) -> String {
    let unit = width.max(height) as f64 / 1000.0;
    // The bar is below the picture, so that it hides nothing.
    let strip = if marks.iter().any(|m| matches!(m, Mark::Scale(..))) { 56.0 * unit } else { 0.0 };
    let total = height as f64 + strip;
    let mut svg = format!(
        "<svg viewBox=\"0 0 {width} {total:.1}\" xmlns=\"http://www.w3.org/2000/svg\" role=\"img\">\
         <rect width=\"{width}\" height=\"{total:.1}\" fill=\"#fff\"/><image width=\"{width}\" height=\"{height}\" style=\"image-rendering:auto\" \
         href=\"data:image/png;base64,{}\"/>",
        base64(png)
    );
    let (pen, text) = (3.0 * unit, 26.0 * unit);
    for mark in marks {
        // Writing to a string cannot fail.
        let _ = match mark {
            Mark::Frame([x, y, w, h], label) => write!(
                svg,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"none\" \
                 stroke=\"#d62728\" stroke-width=\"{pen:.2}\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" font-family=\"sans-serif\" font-weight=\"bold\" \
                 font-size=\"{text:.1}\" fill=\"#d62728\" stroke=\"#fff\" stroke-width=\"{:.2}\" \
                 paint-order=\"stroke\">{}</text>",
                x + w + 1.5 * pen,
                y + 0.4 * text,
                1.2 * pen,
                escape(label)
            ),
            Mark::Line(points) => {
                let points: Vec<String> = points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
                write!(
                    svg,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"#1f77b4\" stroke-opacity=\"0.75\" \
                     stroke-width=\"{:.2}\"/>",
                    points.join(" "),
                    0.7 * pen
                )
            }
            Mark::Scale(length, label) => {
                let (x, y) = (20.0 * unit, total - 14.0 * unit);
                write!(
                    svg,
                    "<path d=\"M{x:.1} {y:.1}h{length:.1}\" stroke=\"#20252b\" stroke-width=\"{:.2}\"/>\
                     <text x=\"{x:.1}\" y=\"{:.1}\" font-family=\"sans-serif\" font-size=\"{text:.1}\" \
                     fill=\"#20252b\" stroke=\"#fff\" stroke-width=\"{pen:.2}\" paint-order=\"stroke\">{}</text>",
                    2.0 * pen,
                    y - 10.0 * unit,
                    escape(label)
                )
            }
        };
    }
    svg + "</svg>"
}

/// A scale bar for a picture with pixels of `resolution` metres.
pub fn scale_mark(width: usize, resolution: f64) -> Option<Mark> {
    let length = crate::overlay::round_length(0.2 * width as f64 * resolution)?;
    Some(Mark::Scale(length / resolution, crate::overlay::length_label(length)))
}

/// Base64 encoding (RFC 4648, section 4).
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let at = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i) & 63) as usize];
            text.push(if i > group.len() { '=' } else { char::from(digit) });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_in_the_standard() {
        let cases = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("foobar", "Zm9vYmFy"),
        ];
        for (plain, coded) in cases {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn external_text_is_escaped() {
        let mut page = HtmlPage::new("<script>");
        page.paragraph("a & b");
        page.table(&["", "x"], &[["\"quoted\"".to_owned(), "-1".to_owned()]]);
        let picture = marked_picture(&[1, 2, 3], 10, 20, &[Mark::Frame([0.0; 4], "<1>".to_owned())]);
        page.figures(&[(picture, "it's".to_owned())]);
        let html = page.finish();
        assert!(!html.contains("<script>") && !html.contains("<1>") && html.contains("a &amp; b"));
        assert!(html.contains("<td class=\"n\">-1</td>") && html.contains("base64,AQID"));
    }
}
