"""What is done to bytes, texts and tables so that they mean harm; all by a random.Random."""

from contextlib import closing, suppress
import sqlite3
import struct
import zlib

from tampering import FLOATS, NUMBERS, TEXTS

STRANGE = (b'\xff' * 8, b'\xff' * 7 + b'\x7f', bytes(8), b'\0\0\0\0\1\0\0\0', b'\0\0\0\x80' * 2)
WORDS = (b'\xff' * 4, b'\xff\xff\xff\x7f', bytes(4), b'\1\0\0\0', b'\0\0\0\x80', b'\0\0\xc0\x7f')
# Values as somebody writes them into YAML.
VALUES = (*map(str, NUMBERS), '.nan', '.inf', '-.inf', '1e-320', '1e309', '~', '""', '[]', '{}',
          '[1, 2', '!!int ""', '!!binary x', '!!timestamp x', '&a [*a]', '*a', '<<: {a: 1}',
          '"\\0"', '"\\e[2J"', '[[[[1]]]]', 'yes', '0x10', '1:30', '2001-01-01', '? a', '- - - 1',
          '[' * 40, '{a: ' * 40, 'x' * 12_000, '9' * 5000, '"a: b', '|', '>-', '%', '@', '`')


def damaged(rng, data, same=False):
    """Return bytes that were cut, flipped, zeroed or filled; *same*: of the same length."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not data:
            break
        at, act = rng.randrange(len(data)), rng.choice((1, 3, 5, 6) if same else range(8))
        if act == 0:
            del data[at:]
        elif act == 1:
            data[at] ^= 1 << rng.randrange(8)
        elif act == 2:
            del data[at:at + rng.randrange(1, 300)]
        elif act == 3:
            data[at:at + 9] = bytes(len(data[at:at + 9]))
        elif act == 4:
            data[at:at] = rng.randbytes(rng.randrange(1, 60))
        elif act == 5:
            data[at:at + 8] = rng.choice(STRANGE)[:len(data[at:at + 8])]
        elif act == 6:
            at -= at % 4
            data[at:at + 4] = rng.choice(WORDS)[:len(data[at:at + 4])]
        else:
            data[at:at] = str(rng.choice(NUMBERS + FLOATS + TEXTS)).encode()
    return bytes(data)


def damaged_png(rng, data):
    """Return a PNG of which a chunk is damaged, its length and checksum right."""
    chunks, at = [], 8
    while at < len(data):
        size = int.from_bytes(data[at:at + 4], 'big')
        chunks.append([data[at + 4:at + 8], data[at + 8:at + 8 + size]])
        at += 12 + size
    chosen = rng.choice(chunks)
    if chosen[0] == b'IHDR' and rng.random() < 0.8:
        width, height = rng.choice(((1, 1), (8, 6), (60_000, 1), (1, 1 << 20), (9000, 9000),
                                    (0, 6)))
        chosen[1] = struct.pack('>IIBBBBB', width, height, rng.choice((1, 2, 4, 8, 16, 3)),
                                rng.choice((0, 2, 3, 4, 6, 1)), 0, 0, rng.choice((0, 0, 1, 2)))
    elif chosen[0] == b'IDAT' and rng.random() < 0.7:
        chosen[1] = zlib.compress(damaged(rng, zlib.decompress(chosen[1])))
    elif rng.random() < 0.3:
        chunks.insert(rng.randrange(len(chunks)), [rng.choice(
            (b'zTXt', b'iCCP', b'PLTE', b'tRNS', b'eXIf', b'acTL', b'fcTL', b'IDAT')),
            rng.randbytes(rng.randrange(60))])
    else:
        chosen[1] = damaged(rng, chosen[1])
    return data[:8] + b''.join(
        struct.pack('>I', len(content)) + name + content
        + struct.pack('>I', zlib.crc32(name + content)) for name, content in chunks)


def damaged_picture(rng, data):
    """Return a picture or array file that is damaged, some in ways that only its parts show."""
    if data[:4] == b'\x89PNG' and rng.random() < 0.7:
        return damaged_png(rng, data)
    if data[:1] == b'\x93' and rng.random() < 0.5:      # .npy: its header is a text
        size = int.from_bytes(data[8:10], 'little')
        head = damaged(rng, data[10:10 + size])
        return data[:8] + struct.pack('<H', len(head) & 0xffff) + head + data[10 + size:]
    return damaged(rng, data, same=rng.random() < 0.7)


def damaged_text(rng, text):
    """Return a text of lines 'name: value': its bytes damaged, or its values and lines changed."""
    if rng.random() < 0.4:
        return damaged(rng, text.encode()).decode('utf-8', 'replace')
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 2, 4))):
        k, act = rng.randrange(len(lines)), rng.randrange(6)
        head, colon, _ = lines[k].rpartition(': ')
        if act == 0:
            lines.insert(k, lines[rng.randrange(len(lines))])
        elif act == 1 and len(lines) > 1:
            del lines[k]
        elif act == 2:
            lines[k] = ' ' * rng.randrange(9) + lines[k].strip()
        else:
            lines[k] = f'{head or lines[k]}{colon or ": "}{rng.choice(VALUES)}' \
                + ('}' if lines[k].endswith('}') and rng.random() < 0.8 else '')
    return '\n'.join(lines) + '\n'


def damage_rows(rng, database):
    """Damage messages, or other values, in a storage file that stays a whole database."""
    with closing(sqlite3.connect(database)) as db:
        db.execute('PRAGMA synchronous = OFF')
        for _ in range(rng.choice((1, 1, 3))):
            table, name = rng.choice((
                ('messages', 'data'), ('messages', 'data'), ('messages', 'data'),
                ('messages', 'timestamp'), ('messages', 'topic_id'), ('topics', 'name'),
                ('topics', 'type'), ('topics', 'serialization_format'),
                ('topics', 'offered_qos_profiles'), ('topics', 'id')))
            key, value = rng.choice(list(db.execute(f'SELECT rowid, {name} FROM {table}')))
            if isinstance(value, bytes) and rng.random() < 0.8:
                value = damaged(rng, value)
            else:
                value = rng.choice((None, 'text', b'', b'\0' * 9, '\0', 'a\x1b[2J', 1e300, -1, 0,
                                    2 ** 63 - 1, -2 ** 63, 'x' * 20_000))
            with suppress(sqlite3.Error):
                db.execute(f'UPDATE {table} SET {name} = ? WHERE rowid = ?', (value, key))
        db.commit()
