//! Reads Python pickles as plain data. No code is imported, called or otherwise executed.
//!
//! The opcodes of protocols 0 to 5 build numbers, bytes, lists, dictionaries and objects. An object is the name of its
//! class, its arguments and its state. Only the classes of body models are allowed.

use std::borrow::Cow;
use std::collections::HashMap;

/// The most objects in a pickle, far more than any body model has. It bounds the memory for a hostile file.
const MAX_NODES: usize = 1 << 20;

/// Index of a value. Values may be shared and may even contain themselves, so a traversal must bound its depth.
pub type Id = usize;

/// A value.
#[derive(Debug, Clone, PartialEq)]
pub enum Node<'a> {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    /// Bytes, or a string as UTF-8.
    Bytes(Cow<'a, [u8]>),
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// `module.name` of a class or function.
    Global(String),
    /// An object: the class or function that makes it, a [`Node::Global`], its arguments, a [`Node::Tuple`], and the
    /// state that is set afterwards.
    Object {
        class: Id,
        arguments: Id,
        state: Option<Id>,
    },
}

/// A whole pickle.
#[derive(Debug)]
pub struct Pickle<'a> {
    nodes: Vec<Node<'a>>,
    root: Id,
}

impl<'a> Pickle<'a> {
    /// Reads a pickle. Bytes after its end are ignored.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut machine =
            Machine { bytes, at: 0, nodes: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() };
        loop {
            let start = machine.at;
            match machine.step() {
                Ok(None) => {}
                Ok(Some(root)) => return Ok(Self { nodes: machine.nodes, root }),
                Err(reason) => return Err(format!("byte {start}: {reason}")),
            }
        }
    }

    /// The value that the pickle holds.
    pub fn root(&self) -> &Node<'a> {
        &self.nodes[self.root]
    }

    /// The value with this index.
    pub fn node(&self, id: Id) -> &Node<'a> {
        &self.nodes[id]
    }

    /// The name of a class or function; empty for any other value.
    pub fn name(&self, id: Id) -> &str {
        match &self.nodes[id] {
            Node::Global(name) => name,
            _ => "",
        }
    }

    /// The items of a tuple or list; none for any other value.
    pub fn items<'b>(&'b self, node: &'b Node) -> impl ExactSizeIterator<Item = &'b Node<'a>> {
        let ids: &[Id] = match node {
            Node::Tuple(ids) | Node::List(ids) => ids,
            _ => &[],
        };
        ids.iter().map(|&id| self.node(id))
    }

    /// The value of a string key in a dictionary.
    pub fn get(&self, dict: &Node, key: &str) -> Option<&Node<'a>> {
        let Node::Dict(items) = dict else { return None };
        let is_key = |id: Id| matches!(self.node(id), Node::Bytes(bytes) if **bytes == *key.as_bytes());
        // As in Python, the last value of a key is valid.
        items.iter().rev().find(|(id, _)| is_key(*id)).map(|(_, value)| self.node(*value))
    }
}

/// Whether a name is a known class of arrays or sparse matrices, or a function that makes them.
fn is_known(module: &str, name: &str) -> bool {
    match module {
        "copy_reg" | "copyreg" => name == "_reconstructor",
        "__builtin__" | "builtins" => name == "object",
        "_codecs" => name == "encode",
        "numpy" => matches!(name, "ndarray" | "dtype"),
        "numpy.core.multiarray" | "numpy._core.multiarray" => matches!(name, "_reconstruct" | "scalar"),
        "numpy.core.numeric" | "numpy._core.numeric" => name == "_frombuffer",
        "scipy.sparse.csc" | "scipy.sparse._csc" => name == "csc_matrix",
        _ => module == "chumpy" || module.starts_with("chumpy."),
    }
}

/// The stack machine of a pickle.
struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    nodes: Vec<Node<'a>>,
    stack: Vec<Id>,
    /// Heights of the stack at the open marks.
    marks: Vec<usize>,
    memo: HashMap<u64, Id>,
}

type Step<T> = Result<T, String>;

impl<'a> Machine<'a> {
    /// Executes one opcode. The last opcode returns the value of the pickle.
    fn step(&mut self) -> Step<Option<Id>> {
        let opcode = self.take(1)?[0];
        match opcode {
            b'.' => return self.pop().map(Some),
            b'\x80' => self.protocol()?,
            b'\x95' => drop(self.take(8)?),
            b'(' => self.mark()?,
            b'0' => drop(self.pop()?),
            b'1' => drop(self.pop_mark()?),
            b'2' => {
                let top = *self.stack.last().ok_or(EMPTY)?;
                self.push(top)?;
            }
            b'p' | b'q' | b'r' | b'\x94' | b'g' | b'h' | b'j' => self.memoize(opcode)?,
            b'N' => self.add(Node::None)?,
            b'\x88' | b'\x89' => self.add(Node::Bool(opcode == b'\x88'))?,
            b'I' | b'L' | b'J' | b'K' | b'M' | b'\x8a' | b'\x8b' | b'F' | b'G' => self.number(opcode)?,
            b'S' | b'V' | b'T' | b'U' | b'X' | b'B' | b'C' | b'\x8c' | b'\x8d' | b'\x8e' | b'\x96' => {
                self.string(opcode)?;
            }
            b')' | b't' | b'\x85' | b'\x86' | b'\x87' | b']' | b'l' | b'a' | b'e' | b'}' | b'd' | b's' | b'u' => {
                self.collection(opcode)?;
            }
            b'c' | b'\x93' | b'R' | b'\x81' | b'b' => self.object(opcode)?,
            _ => return Err(format!("opcode 0x{opcode:02x} is not one that body models need")),
        }
        Ok(None)
    }

    fn protocol(&mut self) -> Step<()> {
        match self.take(1)?[0] {
            0..=5 => Ok(()),
            newer => Err(format!("protocol {newer}; up to 5 can be read")),
        }
    }

    /// Stores the top of the stack in the memo, or pushes a value of the memo.
    fn memoize(&mut self, opcode: u8) -> Step<()> {
        let key = match opcode {
            b'p' | b'g' => self.parsed_line("number of the memo")?,
            b'q' | b'h' => u64::from(self.take(1)?[0]),
            b'r' | b'j' => self.length(4)? as u64,
            _ => self.memo.len() as u64,
        };
        if matches!(opcode, b'g' | b'h' | b'j') {
            let known = *self.memo.get(&key).ok_or_else(|| format!("nothing is kept as number {key}"))?;
            return self.push(known);
        }
        let top = *self.stack.last().ok_or(EMPTY)?;
        if self.memo.len() == MAX_NODES {
            return Err(TOO_MANY.into());
        }
        self.memo.insert(key, top);
        Ok(())
    }

    fn number(&mut self, opcode: u8) -> Step<()> {
        let node = match opcode {
            b'I' => match self.line()? {
                b"00" => Node::Bool(false),
                b"01" => Node::Bool(true),
                line => Node::Int(parsed(line, "number")?),
            },
            b'L' => {
                let line = self.line()?;
                Node::Int(parsed(line.strip_suffix(b"L").unwrap_or(line), "number")?)
            }
            b'J' => Node::Int(i32::from_le_bytes(self.array()?).into()),
            b'K' => Node::Int(self.take(1)?[0].into()),
            b'M' => Node::Int(u16::from_le_bytes(self.array()?).into()),
            b'\x8a' | b'\x8b' => {
                let length = self.length(if opcode == b'\x8a' { 1 } else { 4 })?;
                Node::Int(little_endian(self.take(length)?)?)
            }
            b'F' => Node::Float(self.parsed_line("number")?),
            _ => Node::Float(f64::from_be_bytes(self.array()?)),
        };
        self.add(node)
    }

    fn string(&mut self, opcode: u8) -> Step<()> {
        let bytes = match opcode {
            b'S' => Cow::Owned(unquoted(self.line()?)?),
            b'V' => Cow::Borrowed(self.line()?),
            _ => {
                let width = match opcode {
                    b'U' | b'C' | b'\x8c' => 1,
                    b'T' | b'X' | b'B' => 4,
                    _ => 8,
                };
                let length = self.length(width)?;
                Cow::Borrowed(self.take(length)?)
            }
        };
        self.add(Node::Bytes(bytes))
    }

    fn collection(&mut self, opcode: u8) -> Step<()> {
        match opcode {
            b')' => self.add(Node::Tuple(Vec::new())),
            b']' => self.add(Node::List(Vec::new())),
            b'}' => self.add(Node::Dict(Vec::new())),
            b'\x85'..=b'\x87' => {
                let height = self.stack.len().checked_sub(usize::from(opcode - b'\x84')).ok_or(EMPTY)?;
                let items = self.split_off(height)?;
                self.add(Node::Tuple(items))
            }
            b't' => {
                let items = self.pop_mark()?;
                self.add(Node::Tuple(items))
            }
            b'l' => {
                let items = self.pop_mark()?;
                self.add(Node::List(items))
            }
            b'd' => {
                let items = pairs(&self.pop_mark()?)?;
                self.add(Node::Dict(items))
            }
            b'a' | b'e' => {
                let items = if opcode == b'a' { vec![self.pop()?] } else { self.pop_mark()? };
                match self.top()? {
                    Node::List(list) => list.extend(items),
                    _ => return Err("something is appended to what is no list".into()),
                }
                Ok(())
            }
            _ => {
                let items = if opcode == b's' { vec![self.pop()?, self.pop()?] } else { self.pop_mark()? };
                let items = if opcode == b's' { vec![(items[1], items[0])] } else { pairs(&items)? };
                match self.top()? {
                    Node::Dict(dict) => dict.extend(items),
                    _ => return Err("an item is set in what is no dictionary".into()),
                }
                Ok(())
            }
        }
    }

    /// Executes the opcodes of classes and functions, of objects and of objects' states.
    fn object(&mut self, opcode: u8) -> Step<()> {
        match opcode {
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.global(module, name)
            }
            b'\x93' => {
                let (name, module) = (self.pop()?, self.pop()?);
                let (Node::Bytes(module), Node::Bytes(name)) = (self.nodes[module].clone(), self.nodes[name].clone())
                else {
                    return Err("a global without a name".into());
                };
                self.global(&module, &name)
            }
            b'b' => {
                let state = self.pop()?;
                match self.top()? {
                    Node::Object { state: of_object, .. } => *of_object = Some(state),
                    _ => return Err("a state is given to what is no object".into()),
                }
                Ok(())
            }
            _ => {
                let (arguments, class) = (self.pop()?, self.pop()?);
                let (Node::Global(name), Node::Tuple(items)) = (&self.nodes[class], &self.nodes[arguments]) else {
                    return Err("only known classes and functions can be called".into());
                };
                // Protocols 0 and 1 make objects with a function of the arguments (class, object, None).
                let class = match name.ends_with("._reconstructor") {
                    true => *items.first().ok_or("an object without a class")?,
                    false => class,
                };
                self.add(Node::Object { class, arguments, state: None })
            }
        }
    }

    fn global(&mut self, module: &[u8], name: &[u8]) -> Step<()> {
        let [module, name] = [module, name].map(String::from_utf8_lossy);
        if !is_known(&module, &name) {
            return Err(format!("`{module:.80}.{name:.80}` is none of the classes of body models"));
        }
        self.add(Node::Global(format!("{module:.80}.{name:.80}")))
    }

    fn mark(&mut self) -> Step<()> {
        if self.marks.len() == MAX_NODES {
            return Err(TOO_MANY.into());
        }
        self.marks.push(self.stack.len());
        Ok(())
    }

    /// Removes and returns the values since the last mark.
    fn pop_mark(&mut self) -> Step<Vec<Id>> {
        let height = self.marks.pop().ok_or("a mark is missing")?;
        Ok(self.stack.split_off(height))
    }

    fn pop(&mut self) -> Step<Id> {
        match self.marks.last() {
            Some(&mark) if mark >= self.stack.len() => Err(EMPTY.into()),
            _ => self.stack.pop().ok_or_else(|| EMPTY.into()),
        }
    }

    /// Removes and returns the values from a height of the stack on. The height must not be below the last mark.
    fn split_off(&mut self, height: usize) -> Step<Vec<Id>> {
        if self.marks.last().is_some_and(|mark| height < *mark) {
            return Err(EMPTY.into());
        }
        Ok(self.stack.split_off(height))
    }

    fn top(&mut self) -> Step<&mut Node<'a>> {
        let top = *self.stack.last().ok_or(EMPTY)?;
        Ok(&mut self.nodes[top])
    }

    fn add(&mut self, node: Node<'a>) -> Step<()> {
        if self.nodes.len() == MAX_NODES {
            return Err(TOO_MANY.into());
        }
        self.nodes.push(node);
        self.push(self.nodes.len() - 1)
    }

    fn push(&mut self, id: Id) -> Step<()> {
        if self.stack.len() == MAX_NODES {
            return Err(TOO_MANY.into());
        }
        self.stack.push(id);
        Ok(())
    }

    /// The next bytes. They are borrowed, so a length beyond the end of the file allocates nothing.
    fn take(&mut self, length: usize) -> Step<&'a [u8]> {
        let end = self.at.checked_add(length);
        let taken = end.and_then(|end| self.bytes.get(self.at..end)).ok_or("cut short")?;
        self.at += length;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Step<[u8; N]> {
        let taken = self.take(N)?;
        Ok(std::array::from_fn(|i| taken[i]))
    }

    /// Reads a length that is stored in `width` bytes.
    fn length(&mut self, width: usize) -> Step<usize> {
        let mut bytes = [0; 8];
        bytes[..width].copy_from_slice(self.take(width)?);
        usize::try_from(u64::from_le_bytes(bytes)).map_err(|_| "cut short".into())
    }

    /// The text up to the end of the line, without the line break.
    fn line(&mut self) -> Step<&'a [u8]> {
        let length = self.bytes[self.at..].iter().position(|&byte| byte == b'\n').ok_or("cut short")?;
        let line = self.take(length + 1)?;
        Ok(line[..length].strip_suffix(b"\r").unwrap_or(&line[..length]))
    }

    fn parsed_line<T: std::str::FromStr>(&mut self, what: &str) -> Step<T> {
        parsed(self.line()?, what)
    }
}

const EMPTY: &str = "a value is missing";
const TOO_MANY: &str = "more objects than a body model has";

fn parsed<T: std::str::FromStr>(text: &[u8], what: &str) -> Step<T> {
    let text = String::from_utf8_lossy(text);
    text.parse().map_err(|_| format!("`{text:.20}` is no {what}"))
}

/// Pairs of alternating keys and values.
fn pairs(items: &[Id]) -> Step<Vec<(Id, Id)>> {
    if items.len() % 2 == 1 {
        return Err("a key without a value".into());
    }
    Ok(items.chunks_exact(2).map(|pair| (pair[0], pair[1])).collect())
}

/// A number in two's complement.
fn little_endian(bytes: &[u8]) -> Step<i64> {
    let sign = if bytes.last().is_some_and(|byte| byte & 0x80 != 0) { 0xff } else { 0 };
    let mut all = [sign; 8];
    all.get_mut(..bytes.len()).ok_or("a number of more than 8 bytes")?.copy_from_slice(bytes);
    Ok(i64::from_le_bytes(all))
}

/// The content of a quoted Python 2 string, with its escapes resolved.
fn unquoted(line: &[u8]) -> Step<Vec<u8>> {
    let inner = [b"'", b"\""].iter().find_map(|quote| line.strip_prefix(*quote)?.strip_suffix(*quote));
    let mut rest = inner.ok_or("a string without quotes")?;
    let mut bytes = Vec::with_capacity(rest.len());
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte != b'\\' {
            bytes.push(byte);
            continue;
        }
        let (&escape, after) = rest.split_first().ok_or("a string ends within an escape")?;
        rest = after;
        bytes.push(match escape {
            b'n' => b'\n',
            b'r' => b'\r',
            b't' => b'\t',
            b'\\' | b'\'' | b'"' => escape,
            b'x' => {
                let (digits, after) = rest.split_at_checked(2).ok_or("a string ends within an escape")?;
                rest = after;
                let digits = std::str::from_utf8(digits).unwrap_or_default();
                u8::from_str_radix(digits, 16).map_err(|_| format!("unknown escape `\\x{digits}`"))?
            }
            other => return Err(format!("unknown escape `\\{}`", char::from(other).escape_default())),
        });
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ints(pickle: &Pickle, node: &Node) -> Vec<i64> {
        let (Node::Tuple(items) | Node::List(items)) = node else { panic!("{node:?}") };
        items.iter().map(|&id| if let Node::Int(value) = pickle.node(id) { *value } else { panic!() }).collect()
    }

    #[test]
    fn numbers_and_strings_of_every_opcode() {
        // I01, I-7, L8L, BININT -2, BININT1 200, BININT2 65535, LONG1 -129 and 0, LONG4 3, in a list by APPENDS.
        let text: &[u8] =
            b"](I-7\nL8L\nJ\xfe\xff\xff\xffK\xc8M\xff\xff\x8a\x02\x7f\xff\x8a\x00\x8b\x01\x00\x00\x00\x03e.";
        let pickle = Pickle::parse(text).unwrap();
        assert_eq!(ints(&pickle, pickle.root()), [-7, 8, -2, 200, 65535, -129, 0, 3]);
        for (text, expected) in [
            (&b"F-1.5\n."[..], Node::Float(-1.5)),
            (b"G\xbf\xf8\0\0\0\0\0\0.", Node::Float(-1.5)),
            (b"N.", Node::None),
            (b"I01\n.", Node::Bool(true)),
            (b"\x89.", Node::Bool(false)),
        ] {
            assert_eq!(Pickle::parse(text).unwrap().root(), &expected);
        }
        for text in [
            &b"S'a\\x00\\'\\n\\\\'\n."[..],
            b"U\x05a\0'\n\\.",
            b"T\x05\0\0\0a\0'\n\\.",
            b"C\x05a\0'\n\\.",
            b"B\x05\0\0\0a\0'\n\\.",
            b"X\x05\0\0\0a\0'\n\\.",
            b"\x8c\x05a\0'\n\\.",
            b"\x8e\x05\0\0\0\0\0\0\0a\0'\n\\.",
            b"\x96\x05\0\0\0\0\0\0\0a\0'\n\\.",
        ] {
            assert_eq!(Pickle::parse(text).unwrap().root(), &Node::Bytes(b"a\0'\n\\"[..].into()));
        }
    }

    #[test]
    fn collections_and_the_memo() {
        // {"a": (1, 2), "b": the same tuple} by protocol 2, and by protocol 0.
        for text in [
            &b"\x80\x02}q\x00(U\x01aK\x01K\x02\x86q\x01U\x01bh\x01u."[..],
            b"(dp0\nS'a'\n(I1\nI2\ntp1\nsS'b'\ng1\ns.",
            b"\x80\x04\x95\x10\0\0\0\0\0\0\0}\x94(\x8c\x01aK\x01K\x02\x86\x94\x8c\x01bh\x01u.",
        ] {
            let pickle = Pickle::parse(text).unwrap();
            for key in ["a", "b"] {
                assert_eq!(ints(&pickle, pickle.get(pickle.root(), key).unwrap()), [1, 2]);
            }
            assert_eq!(pickle.get(pickle.root(), "c"), None);
        }
        // The last value of a key is valid. Also tests POP, DUP and POP_MARK.
        let pickle = Pickle::parse(b"}(U\x01aK\x01U\x01aK\x02uK\x0902(K\x01K\x0210.").unwrap();
        assert_eq!(pickle.get(pickle.root(), "a"), Some(&Node::Int(2)));
    }

    #[test]
    fn objects_are_named_and_never_made() {
        let reduced = Pickle::parse(b"cnumpy\ndtype\nU\x02f8\x85R(K\x03U\x01<tb.").unwrap();
        let Node::Object { class, arguments, state: Some(_) } = *reduced.root() else { panic!("{reduced:?}") };
        assert_eq!((reduced.name(class), reduced.items(reduced.node(arguments)).len()), ("numpy.dtype", 1));
        for text in [
            &b"\x80\x02cchumpy.ch\nCh\n)\x81}b."[..],
            b"ccopy_reg\n_reconstructor\n(cchumpy.ch\nCh\nc__builtin__\nobject\nNtR(dp0\nb.",
            b"\x80\x04\x8c\tchumpy.ch\x8c\x02Ch\x93)\x81}b.",
        ] {
            let pickle = Pickle::parse(text).unwrap();
            assert!(matches!(pickle.root(), Node::Object { class, .. } if pickle.name(*class) == "chumpy.ch.Ch"));
        }
    }

    #[test]
    fn hostile_pickles_are_refused() {
        let refused = |text: &[u8], message: &str| {
            let reason = Pickle::parse(text).unwrap_err();
            assert!(reason.contains(message), "{reason}");
        };
        refused(b"cos\nsystem\n(S'true'\ntR.", "byte 0: `os.system` is none of the classes");
        refused(b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93.", "`builtins.eval`");
        refused(b"cnumpy\nload\n.", "`numpy.load`");
        // chumpyx is not a module of chumpy.
        refused(b"cchumpyx\nCh\n.", "`chumpyx.Ch`");
        refused(b"K\x01)R.", "only known classes");
        refused(b"(i__main__\nA\n.", "opcode 0x69");
        refused(b"P1\n.", "opcode 0x50");
        refused(b"\x80\x09.", "protocol 9");
        refused(b"h\x07.", "nothing is kept as number 7");
        refused(b"K\x01a.", "a value is missing");
        refused(b"K\x01K\x02a.", "no list");
        refused(b"}(K\x01u.", "a key without a value");
        refused(b"}K\x01b.", "no object");
        // Opcodes cannot take values from below the mark.
        refused(b"K\x01(0.", "a value is missing");
        refused(b"K\x01K\x02(\x86.", "a value is missing");
        refused(b"\x8a\x09000000000.", "more than 8 bytes");
        for text in [&b""[..], b"T\xff\xff\xff\xff", b"\x8e\xff\xff\xff\xff\xff\xff\xff\xff", b"I1", b"cnumpy\n"] {
            refused(text, "cut short");
        }
        // More nesting, marks, copies and memo entries than any model has.
        for opcodes in [&b"]"[..], b"(", b"K\x01\x94", b"N0"] {
            refused(&opcodes.repeat(MAX_NODES + 1), "more objects");
        }
        refused(&[&b"N"[..], &b"2".repeat(MAX_NODES)].concat(), "more objects");
        // Each list contains the previous one twice, so the last one has 2^60 values. Another list contains itself.
        let bomb = [&b"]q\x00"[..], &b"0](h\x00h\x00eq\x00".repeat(60), b"."].concat();
        let pickle = Pickle::parse(&bomb).unwrap();
        assert_eq!((pickle.nodes.len(), pickle.items(pickle.root()).len()), (61, 2));
        assert!(Pickle::parse(b"]q\x00h\x00a.").is_ok());
    }

    #[test]
    fn cut_anywhere_there_is_an_error() {
        let text: &[u8] =
            b"\x80\x02}q\x00(U\x01acnumpy\ndtype\nU\x02f8\x85R(K\x03U\x01<tbX\x01\0\0\0bG\xbf\xf8\0\0\0\0\0\0u.";
        assert!(Pickle::parse(text).is_ok());
        for length in 0..text.len() {
            Pickle::parse(&text[..length]).unwrap_err();
        }
    }
}
