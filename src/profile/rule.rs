//! Gates of one's own: an expression over named properties of a candidate's pixels.
//!
//! ```text
//! rule       = and { "or" and }
//! and        = not { "and" not }
//! not        = "not" not | "(" rule ")" | comparison
//! comparison = value op value { op value } | value "in" ("[" | "(") value "," value ("]" | ")")
//! op         = "<" | "<=" | ">" | ">=" | "==" | "!="
//! value      = number | property
//! ```
//!
//! `[` and `]` take their bound in, `(` and `)` leave it out; `0.2 < eccentricity <= 0.9` is both comparisons.
//!
//! ```
//! use autoref_stream::profile::Rule;
//! let rule: Rule = "area in [20, 400) and not solidity < 0.8".parse().expect("a rule");
//! assert!(rule.holds(&|property| if property == autoref_stream::profile::Property::Area { 20.0 } else { 0.8 }));
//! let error = "area > 20 and roundness > 0.5".parse::<Rule>().expect_err("no such property");
//! assert!(error.contains("column 15"), "{error}");
//! ```

use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// What a rule may name. Lengths are in pixels, areas in px².
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Property {
    /// Number of pixels.
    Area,
    /// Crack length of the outline, holes included.
    Perimeter,
    /// Sides of the bounding box.
    Width,
    Height,
    /// Area over area of the bounding box.
    Extent,
    /// Of the ellipse with the same second moments: 0 a circle, 1 a line.
    Eccentricity,
    /// Area over area of the convex hull.
    Solidity,
    /// 4π · area / perimeter².
    Compactness,
    /// Distance of the pixels' colours from the paint, over the profile's limit: mean, least and largest.
    MeanDistance,
    MinDistance,
    MaxDistance,
}

const NAMES: [(&str, Property); 11] = [
    ("area", Property::Area),
    ("perimeter", Property::Perimeter),
    ("width", Property::Width),
    ("height", Property::Height),
    ("extent", Property::Extent),
    ("eccentricity", Property::Eccentricity),
    ("solidity", Property::Solidity),
    ("compactness", Property::Compactness),
    ("mean_distance", Property::MeanDistance),
    ("min_distance", Property::MinDistance),
    ("max_distance", Property::MaxDistance),
];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Operand {
    Number(f64),
    Property(Property),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Order {
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
    Equal,
    NotEqual,
}

impl Order {
    fn holds(self, a: f64, b: f64) -> bool {
        match self {
            Order::Less => a < b,
            Order::LessOrEqual => a <= b,
            Order::Greater => a > b,
            Order::GreaterOrEqual => a >= b,
            Order::Equal => a == b,
            Order::NotEqual => a != b,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
enum Node {
    Compare(Operand, Order, Operand),
    And(Vec<Node>),
    Or(Vec<Node>),
    Not(Box<Node>),
}

/// A parsed rule; as text it is what was written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Rule {
    text: String,
    node: Node,
}

impl Rule {
    /// Whether the candidate with these properties passes.
    pub fn holds(&self, value: &dyn Fn(Property) -> f64) -> bool {
        fn holds(node: &Node, value: &dyn Fn(Property) -> f64) -> bool {
            let of = |operand: &Operand| match operand {
                Operand::Number(number) => *number,
                Operand::Property(property) => value(*property),
            };
            match node {
                Node::Compare(a, order, b) => order.holds(of(a), of(b)),
                Node::And(nodes) => nodes.iter().all(|node| holds(node, value)),
                Node::Or(nodes) => nodes.iter().any(|node| holds(node, value)),
                Node::Not(node) => !holds(node, value),
            }
        }
        holds(&self.node, value)
    }

    /// Whether it asks how far colours are from the profile's paint, which is another number of another paint.
    pub fn asks_of_colour(&self) -> bool {
        const OF_COLOUR: [Property; 3] = [Property::MeanDistance, Property::MinDistance, Property::MaxDistance];
        let of = |operand: &Operand| matches!(operand, Operand::Property(property) if OF_COLOUR.contains(property));
        fn any(node: &Node, of: &dyn Fn(&Operand) -> bool) -> bool {
            match node {
                Node::Compare(a, _, b) => of(a) || of(b),
                Node::And(nodes) | Node::Or(nodes) => nodes.iter().any(|node| any(node, of)),
                Node::Not(node) => any(node, of),
            }
        }
        any(&self.node, &of)
    }

    /// Both rules.
    pub fn and(self, other: Rule) -> Rule {
        Rule { text: format!("({}) and ({})", self.text, other.text), node: Node::And(vec![self.node, other.node]) }
    }
}

impl From<Rule> for String {
    fn from(rule: Rule) -> String {
        rule.text
    }
}

impl TryFrom<String> for Rule {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl FromStr for Rule {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let mut parser = Parser { tokens: tokens(text)?, at: 0, end: text.chars().count() + 1, depth: 0 };
        let node = parser.rule()?;
        match parser.tokens.get(parser.at) {
            None => Ok(Rule { text: text.to_owned(), node }),
            Some((column, token)) => {
                Err(format!("column {column}: `{token}` is one too many; `and` or `or` is expected"))
            }
        }
    }
}

/// Words, numbers and signs with their columns, counted from 1.
fn tokens(text: &str) -> Result<Vec<(usize, String)>, String> {
    let letters: Vec<char> = text.chars().collect();
    let mut out = Vec::new();
    let mut i = 0;
    while i < letters.len() {
        let (start, c) = (i, letters[i]);
        let is_word = |c: char| c.is_alphanumeric() || c == '_' || c == '.';
        if c.is_whitespace() {
            i += 1;
            continue;
        }
        if is_word(c) || ((c == '-' || c == '+') && letters.get(i + 1).is_some_and(|c| c.is_ascii_digit() || *c == '.'))
        {
            i += 1;
            while i < letters.len() {
                let exponent = matches!(letters[i], '+' | '-')
                    && matches!(letters[i - 1], 'e' | 'E')
                    && !letters[start].is_alphabetic();
                if !is_word(letters[i]) && !exponent {
                    break;
                }
                i += 1;
            }
        } else if "<>=!".contains(c) {
            i += if letters.get(i + 1) == Some(&'=') { 2 } else { 1 };
        } else if "()[],".contains(c) {
            i += 1;
        } else {
            return Err(format!("column {}: `{c}` has no meaning in a rule", start + 1));
        }
        out.push((start + 1, letters[start..i].iter().collect()));
    }
    Ok(out)
}

/// Nothing that people write is nested deeper.
const DEEPEST: usize = 64;

struct Parser {
    tokens: Vec<(usize, String)>,
    at: usize,
    end: usize,
    depth: usize,
}

impl Parser {
    fn peek(&self) -> Option<&str> {
        self.tokens.get(self.at).map(|(_, token)| token.as_str())
    }

    fn takes(&mut self, token: &str) -> bool {
        let is = self.peek() == Some(token);
        self.at += usize::from(is);
        is
    }

    /// "column 7: `what`", or where the rule ends.
    fn wrong(&self, expected: &str) -> String {
        match self.tokens.get(self.at) {
            Some((column, token)) => format!("column {column}: `{token}`: {expected} is expected"),
            None => format!("column {}: the rule ends; {expected} is expected", self.end),
        }
    }

    fn rule(&mut self) -> Result<Node, String> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self.wrong("a rule nested less deeply"));
        }
        let mut nodes = vec![self.all()?];
        while self.takes("or") {
            nodes.push(self.all()?);
        }
        self.depth -= 1;
        Ok(if nodes.len() == 1 { nodes.remove(0) } else { Node::Or(nodes) })
    }

    fn all(&mut self) -> Result<Node, String> {
        let mut nodes = vec![self.negated()?];
        while self.takes("and") {
            nodes.push(self.negated()?);
        }
        Ok(if nodes.len() == 1 { nodes.remove(0) } else { Node::And(nodes) })
    }

    fn negated(&mut self) -> Result<Node, String> {
        let mut nots = 0;
        while self.takes("not") {
            nots += 1;
        }
        let node = if self.takes("(") {
            let inner = self.rule()?;
            if !self.takes(")") {
                return Err(self.wrong("`)`"));
            }
            inner
        } else {
            self.comparison()?
        };
        Ok(if nots % 2 == 1 { Node::Not(Box::new(node)) } else { node })
    }

    fn comparison(&mut self) -> Result<Node, String> {
        let mut left = self.operand()?;
        if self.takes("in") {
            return self.interval(left);
        }
        let mut nodes = Vec::new();
        while let Some(order) = self.order() {
            self.at += 1;
            let right = self.operand()?;
            nodes.push(Node::Compare(left, order, right));
            left = right;
        }
        match nodes.len() {
            0 => Err(self.wrong("a comparison (<, <=, >, >=, ==, !=, in)")),
            1 => Ok(nodes.remove(0)),
            _ => Ok(Node::And(nodes)),
        }
    }

    fn order(&self) -> Option<Order> {
        Some(match self.peek()? {
            "<" => Order::Less,
            "<=" => Order::LessOrEqual,
            ">" => Order::Greater,
            ">=" => Order::GreaterOrEqual,
            "==" | "=" => Order::Equal,
            "!=" => Order::NotEqual,
            _ => return None,
        })
    }

    fn interval(&mut self, value: Operand) -> Result<Node, String> {
        let low = match () {
            () if self.takes("[") => Order::GreaterOrEqual,
            () if self.takes("(") => Order::Greater,
            () => return Err(self.wrong("`[` or `(`")),
        };
        let from = self.operand()?;
        if !self.takes(",") {
            return Err(self.wrong("`,`"));
        }
        let to = self.operand()?;
        let high = match () {
            () if self.takes("]") => Order::LessOrEqual,
            () if self.takes(")") => Order::Less,
            () => return Err(self.wrong("`]` or `)`")),
        };
        Ok(Node::And(vec![Node::Compare(value, low, from), Node::Compare(value, high, to)]))
    }

    fn operand(&mut self) -> Result<Operand, String> {
        let Some(token) = self.peek() else { return Err(self.wrong("a number or a property")) };
        let is_number = token.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c));
        if is_number {
            let Some(number) = token.parse::<f64>().ok().filter(|v| v.is_finite()) else {
                return Err(self.wrong("a number"));
            };
            self.at += 1;
            return Ok(Operand::Number(number));
        }
        if let Some((_, property)) = NAMES.iter().find(|(name, _)| *name == token) {
            self.at += 1;
            return Ok(Operand::Property(*property));
        }
        if token.starts_with(char::is_alphabetic) && !["and", "or", "in", "not"].contains(&token) {
            let names = NAMES.map(|(name, _)| name).join(", ");
            let column = self.tokens[self.at].0;
            return Err(format!("column {column}: `{token}` is no property; there are {names}"));
        }
        Err(self.wrong("a number or a property"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holds(text: &str, area: f64, eccentricity: f64) -> bool {
        let rule: Rule = text.parse().unwrap_or_else(|e| panic!("{text}: {e}"));
        rule.holds(&|property| match property {
            Property::Area => area,
            Property::Eccentricity => eccentricity,
            _ => f64::NAN,
        })
    }

    #[test]
    fn bounds_are_in_or_out_as_written() {
        for (text, at_20, at_40) in [
            ("area in [20, 40]", true, true),
            ("area in (20, 40]", false, true),
            ("area in [20, 40)", true, false),
            ("area in (20, 40)", false, false),
            ("20 <= area < 40", true, false),
            ("area > 20", false, true),
            ("area == 20 or area == 40", true, true),
            ("area != 2e1", false, true),
            ("not area >= 40", true, false),
            ("not not area >= 40", false, true),
        ] {
            assert_eq!((holds(text, 20.0, 0.0), holds(text, 40.0, 0.0)), (at_20, at_40), "{text}");
        }
    }

    #[test]
    fn and_binds_before_or_and_parentheses_before_both() {
        assert!(holds("area > 10 or area > 100 and eccentricity > 2", 50.0, 0.5));
        assert!(!holds("(area > 10 or area > 100) and eccentricity > 2", 50.0, 0.5));
        // What has no value holds no comparison.
        assert!(!holds("solidity > 0", 1.0, 0.0) && !holds("solidity <= 0", 1.0, 0.0));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_column() {
        for (text, words) in [
            ("roundness > 1", "column 1: `roundness` is no property"),
            ("area > 20 and Area < 40", "column 15: `Area`"),
            ("area", "column 5: the rule ends"),
            ("area > ", "the rule ends"),
            ("area 20", "column 6: `20`"),
            ("area > 1.2.3", "column 8: `1.2.3`: a number"),
            ("area in 20, 40", "column 9: `20`: `[` or `(`"),
            ("(area > 2", "column 10"),
            ("area > 2 area < 3", "column 10: `area` is one too many"),
            ("area > 2 & area < 3", "column 10: `&` has no meaning"),
            ("area > -inf", "column 8"),
            ("", "column 1: the rule ends"),
        ] {
            let error = text.parse::<Rule>().expect_err(text);
            assert!(error.contains(words), "{text}: {error}");
        }
        assert!("(".repeat(100_000).parse::<Rule>().is_err());
    }
}
