package brain

// twister is the generator of M. Matsumoto and T. Nishimura (1998), begun as numpy begins it with a seed.
type twister struct {
	state [624]uint32
	at    int
}

func newTwister(seed uint64) *twister {
	t := &twister{at: len(twister{}.state) - 1} // where numpy begins
	words(seed, t.state[:])
	t.state[0] = 1 << 31 // so that not all are 0
	return t
}

// uniform returns a number from 0 to below 1.
func (t *twister) uniform() float64 {
	high, low := t.next()>>5, t.next()>>6
	return (float64(float64(high)*(1<<26)) + float64(low)) / (1 << 53)
}

func (t *twister) next() uint32 {
	if t.at == len(t.state) {
		t.twist()
		t.at = 0
	}
	value := t.state[t.at]
	t.at++
	value ^= value >> 11
	value ^= value << 7 & 0x9d2c5680
	value ^= value << 15 & 0xefc60000
	return value ^ value>>18
}

func (t *twister) twist() {
	count := len(t.state)
	for i := range t.state {
		both := t.state[i]&(1<<31) | t.state[(i+1)%count]&(1<<31-1)
		t.state[i] = t.state[(i+397)%count] ^ both>>1 ^ both&1*0x9908b0df
	}
}

// words writes what numpy's SeedSequence (M. E. O'Neill, 2015) makes of a seed.
func words(seed uint64, out []uint32) {
	hashed := func(value uint32, key *uint32, factor uint32) uint32 {
		value ^= *key
		*key *= factor
		value *= *key
		return value ^ value>>16
	}
	pool := [4]uint32{uint32(seed), uint32(seed >> 32)}
	key := uint32(0x43b0d7e5)
	for i := range pool {
		pool[i] = hashed(pool[i], &key, 0x931e8875)
	}
	for from := range pool {
		for to := range pool {
			if from != to {
				mixed := pool[to]*0xca01f9dd - hashed(pool[from], &key, 0x931e8875)*0x4973f715
				pool[to] = mixed ^ mixed>>16
			}
		}
	}
	key = 0x8b51f9dd
	for i := range out {
		out[i] = hashed(pool[i%len(pool)], &key, 0x58f38ded)
	}
}
