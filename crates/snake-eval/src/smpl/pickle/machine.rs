//! The stack machine that a pickle runs on.

use std::collections::HashMap;

use super::scanner::{Scanner, Step};
use super::{Id, Node};

/// The most objects in a pickle, far more than any body model has. It bounds the memory for a hostile file.
pub(super) const MAX_NODES: usize = 1 << 20;

/// Executes the opcodes of a pickle up to its end. Returns all values and the value that the pickle holds.
pub(super) fn run(bytes: &[u8]) -> Step<(Vec<Node<'_>>, Id)> {
    let (scanner, memo) = (Scanner::new(bytes), HashMap::new());
    let mut machine = Machine { scanner, nodes: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo };
    loop {
        let start = machine.scanner.at;
        match machine.step() {
            Ok(None) => {}
            Ok(Some(root)) => return Ok((machine.nodes, root)),
            Err(reason) => return Err(format!("byte {start}: {reason}")),
        }
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
    scanner: Scanner<'a>,
    nodes: Vec<Node<'a>>,
    stack: Vec<Id>,
    /// Heights of the stack at the open marks.
    marks: Vec<usize>,
    memo: HashMap<u64, Id>,
}

impl<'a> Machine<'a> {
    /// Executes one opcode. The last opcode returns the value of the pickle.
    fn step(&mut self) -> Step<Option<Id>> {
        let opcode = self.scanner.take(1)?[0];
        match opcode {
            b'.' => return self.pop().map(Some),
            b'\x80' => self.protocol()?,
            b'\x95' => drop(self.scanner.take(8)?),
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
            b'I' | b'L' | b'J' | b'K' | b'M' | b'\x8a' | b'\x8b' | b'F' | b'G' => {
                let number = self.scanner.number(opcode)?;
                self.add(number)?;
            }
            b'S' | b'V' | b'T' | b'U' | b'X' | b'B' | b'C' | b'\x8c' | b'\x8d' | b'\x8e' | b'\x96' => {
                let string = self.scanner.string(opcode)?;
                self.add(string)?;
            }
            b')' | b't' | b'\x85' | b'\x86' | b'\x87' | b']' | b'l' | b'a' | b'e' | b'}' | b'd' | b's' | b'u' => {
                self.collection(opcode)?;
            }
            b'c' | b'\x93' | b'R' | b'\x81' | b'b' => self.object(opcode)?,
            _ => return Err(format!("opcode 0x{opcode:02x} is not supported")),
        }
        Ok(None)
    }

    fn protocol(&mut self) -> Step<()> {
        match self.scanner.take(1)?[0] {
            0..=5 => Ok(()),
            newer => Err(format!("protocol {newer} is not supported; supported are 0 to 5")),
        }
    }

    /// Stores the top of the stack in the memo, or pushes a value of the memo.
    fn memoize(&mut self, opcode: u8) -> Step<()> {
        let key = match opcode {
            b'p' | b'g' => self.scanner.parsed_line("number of the memo")?,
            b'q' | b'h' => u64::from(self.scanner.take(1)?[0]),
            b'r' | b'j' => self.scanner.length(4)? as u64,
            _ => self.memo.len() as u64,
        };
        if matches!(opcode, b'g' | b'h' | b'j') {
            let known = *self.memo.get(&key).ok_or_else(|| format!("the memo has no entry {key}"))?;
            return self.push(known);
        }
        let top = *self.stack.last().ok_or(EMPTY)?;
        if self.memo.len() == MAX_NODES {
            return Err(TOO_MANY.into());
        }
        self.memo.insert(key, top);
        Ok(())
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
                    _ => return Err("only a list can be extended".into()),
                }
                Ok(())
            }
            _ => {
                let items = if opcode == b's' { vec![self.pop()?, self.pop()?] } else { self.pop_mark()? };
                let items = if opcode == b's' { vec![(items[1], items[0])] } else { pairs(&items)? };
                match self.top()? {
                    Node::Dict(dict) => dict.extend(items),
                    _ => return Err("only a dictionary can have items set".into()),
                }
                Ok(())
            }
        }
    }

    /// Executes the opcodes of classes and functions, of objects and of objects' states.
    fn object(&mut self, opcode: u8) -> Step<()> {
        match opcode {
            b'c' => {
                let (module, name) = (self.scanner.line()?, self.scanner.line()?);
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
                    _ => return Err("only an object can have a state".into()),
                }
                Ok(())
            }
            _ => {
                let (arguments, class) = (self.pop()?, self.pop()?);
                let (Node::Global(name), Node::Tuple(items)) = (&self.nodes[class], &self.nodes[arguments]) else {
                    return Err("only known classes and functions can make objects".into());
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
            return Err(format!("`{module:.80}.{name:.80}` is not a class of body models"));
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
}

const EMPTY: &str = "a value is missing";
const TOO_MANY: &str = "more objects than a body model has";

/// Pairs of alternating keys and values.
fn pairs(items: &[Id]) -> Step<Vec<(Id, Id)>> {
    if items.len() % 2 == 1 {
        return Err("a key without a value".into());
    }
    Ok(items.chunks_exact(2).map(|pair| (pair[0], pair[1])).collect())
}
