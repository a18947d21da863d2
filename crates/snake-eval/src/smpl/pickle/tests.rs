use super::machine::MAX_NODES;
use super::{Node, Pickle};

fn ints(pickle: &Pickle, node: &Node) -> Vec<i64> {
    let (Node::Tuple(items) | Node::List(items)) = node else { panic!("{node:?}") };
    items.iter().map(|&id| if let Node::Int(value) = pickle.node(id) { *value } else { panic!() }).collect()
}

#[test]
fn numbers_and_strings_of_every_opcode() {
    // I01, I-7, L8L, BININT -2, BININT1 200, BININT2 65535, LONG1 -129 and 0, LONG4 3, in a list by APPENDS.
    let text: &[u8] = b"](I-7\nL8L\nJ\xfe\xff\xff\xffK\xc8M\xff\xff\x8a\x02\x7f\xff\x8a\x00\x8b\x01\x00\x00\x00\x03e.";
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
    refused(b"cos\nsystem\n(S'true'\ntR.", "byte 0: `os.system` is not a class");
    refused(b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93.", "`builtins.eval`");
    refused(b"cnumpy\nload\n.", "`numpy.load`");
    // chumpyx is not a module of chumpy.
    refused(b"cchumpyx\nCh\n.", "`chumpyx.Ch`");
    refused(b"K\x01)R.", "only known classes");
    refused(b"(i__main__\nA\n.", "opcode 0x69");
    refused(b"P1\n.", "opcode 0x50");
    refused(b"\x80\x09.", "protocol 9");
    refused(b"h\x07.", "no entry 7");
    refused(b"K\x01a.", "a value is missing");
    refused(b"K\x01K\x02a.", "only a list");
    refused(b"}(K\x01u.", "a key without a value");
    refused(b"}K\x01b.", "only an object");
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
