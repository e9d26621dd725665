// Package blake2b computes the hash BLAKE2b (RFC 7693), without a key, of any length up to 64 bytes.
package blake2b

import (
	"encoding/binary"
	"math/bits"
)

const block = 128 // bytes

var start = [8]uint64{
	0x6a09e667f3bcc908, 0xbb67ae8584caa73b, 0x3c6ef372fe94f82b, 0xa54ff53a5f1d36f1,
	0x510e527fade682d1, 0x9b05688c2b3e6c1f, 0x1f83d9abfb41bd6b, 0x5be0cd19137e2179,
}

var order = [10][16]byte{
	{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15},
	{14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
	{11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4},
	{7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
	{9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13},
	{2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
	{12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11},
	{13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
	{6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5},
	{10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0},
}

// which numbers are mixed with each other: columns, then diagonals.
var mixed = [8][4]int{
	{0, 4, 8, 12}, {1, 5, 9, 13}, {2, 6, 10, 14}, {3, 7, 11, 15},
	{0, 5, 10, 15}, {1, 6, 11, 12}, {2, 7, 8, 13}, {3, 4, 9, 14},
}

// Sum returns the hash of a text, of so many bytes.
func Sum(text []byte, size int) []byte {
	state := start
	state[0] ^= 0x01010000 ^ uint64(size)
	rest, count := text, uint64(0)
	for len(rest) > block {
		count += block
		compress(&state, rest[:block], count, false)
		rest = rest[block:]
	}
	last := make([]byte, block)
	copy(last, rest)
	compress(&state, last, count+uint64(len(rest)), true)
	var sum []byte
	for _, word := range state {
		sum = binary.LittleEndian.AppendUint64(sum, word)
	}
	return sum[:size]
}

func compress(state *[8]uint64, text []byte, count uint64, last bool) {
	var words, v [16]uint64
	for i := range words {
		words[i] = binary.LittleEndian.Uint64(text[8*i:])
	}
	copy(v[:8], state[:])
	copy(v[8:], start[:])
	v[12] ^= count
	if last {
		v[14] = ^v[14]
	}
	for round := range 12 {
		for i, at := range mixed {
			a, b, c, d := &v[at[0]], &v[at[1]], &v[at[2]], &v[at[3]]
			*a += *b + words[order[round%10][2*i]]
			*d = bits.RotateLeft64(*d^*a, -32)
			*c += *d
			*b = bits.RotateLeft64(*b^*c, -24)
			*a += *b + words[order[round%10][2*i+1]]
			*d = bits.RotateLeft64(*d^*a, -16)
			*c += *d
			*b = bits.RotateLeft64(*b^*c, -63)
		}
	}
	for i := range state {
		state[i] ^= v[i] ^ v[i+8]
	}
}
