package nmes

import (
	"bytes"
	"context"
	"crypto/tls"
	"encoding/json"
	"errors"
	"fmt"
	"net"
	"os"
	"strconv"
	"sync"
	"sync/atomic"
	"time"
)

const (
	delimiter = "<???DONE???---"
	// Bytes of one frame: a world of 10,000 cubes is a reply of some megabytes.
	largestFrame = 256 << 20
	// Bytes that may wait to be written before senders wait for the socket.
	writeBacklog = 1 << 20
)

// conn is one connection in the json dialect: it frames, numbers commands, and matches replies, which come in the order
// of the commands. A goroutine reads and another writes many commands at once, so that neither side ever waits for the
// other to read.
//
// A command beside which no other is under way is written by who sends it, and he who waits for its reply reads. A
// controller that waits for each reply so needs no other goroutine: to wake one takes about as long as a tick.
type conn struct {
	socket  net.Conn
	direct  bool // whether a read may be interrupted, and be done by who waits
	events  chan Event
	dropped atomic.Uint64

	mu      sync.Mutex
	room    sync.Cond // there is room again, or the connection is lost
	unsent  []byte
	writing bool    // somebody writes
	waiting []*call // in the order in which they were sent; the first is next to be answered
	count   uint64  // of commands
	lost    error
	wake    chan struct{} // something is to be written
	gone    chan struct{} // closed when the connection is lost
	closed  bool          // the server said that it closes the world

	turn       chan struct{} // full while somebody reads, who has what follows
	buffer     []byte        // what was read, and is not a whole frame
	searched   int           // how much of that has no delimiter
	background atomic.Bool   // who reads is the goroutine that does nothing else
	resume     chan struct{} // it is to read now
	lent       atomic.Int64  // when somebody who waited had the turn last, ns
}

// How long nobody who waits has read until the goroutine that does nothing else reads again.
const lending = 2 * time.Millisecond

// long ago: a deadline that interrupts a read.
var past = time.Unix(1, 0)

// call is a command whose reply is to come.
type call struct {
	conn *conn  // that it went out alone on, beside no other; nil of others
	id   string // "" of the authentication, which has none
	done chan struct{}
	raw  []byte
	err  error
}

func newCall(id string) *call { return &call{id: id, done: make(chan struct{})} }

func (c *call) resolve(raw []byte, err error) {
	c.raw, c.err = raw, err
	close(c.done)
}

func wait[R any](ctx context.Context, c *call) (*R, error) {
	if c.conn != nil {
		c.conn.readFor(ctx, c)
	}
	select {
	case <-c.done:
	default:
		select {
		case <-c.done:
		case <-ctx.Done():
			return nil, ctx.Err()
		}
	}
	if c.err != nil {
		return nil, c.err
	}
	reply := new(R)
	if err := json.Unmarshal(c.raw, reply); err != nil {
		return nil, &Disconnected{"bad_reply", fmt.Sprintf("a reply is not as the schemas say: %v", err)}
	}
	return reply, nil
}

func dial(ctx context.Context, address string, config *tls.Config) (net.Conn, error) {
	var dialer interface {
		DialContext(context.Context, string, string) (net.Conn, error)
	} = &net.Dialer{}
	if config != nil {
		dialer = &tls.Dialer{Config: config}
	}
	socket, err := dialer.DialContext(ctx, "tcp", address)
	if err != nil {
		if ctx.Err() != nil {
			return nil, ctx.Err()
		}
		return nil, &Disconnected{"unreachable", err.Error()}
	}
	return socket, nil
}

func open(ctx context.Context, address string, config *tls.Config) (*conn, error) {
	socket, err := dial(ctx, address, config)
	if err != nil {
		return nil, err
	}
	c := &conn{
		socket: socket,
		events: make(chan Event, EventBacklog),
		wake:   make(chan struct{}, 1),
		gone:   make(chan struct{}),
		turn:   make(chan struct{}, 1),
		resume: make(chan struct{}, 1),
		buffer: make([]byte, 0, 64<<10),
	}
	_, c.direct = socket.(*net.TCPConn)
	c.room.L = &c.mu
	go c.read()
	go c.write()
	return c, nil
}

// encode returns a message as JSON, its type first. Go escapes the < of strings, as the framing needs.
func encode(kind string, fields any) ([]byte, error) {
	body, err := json.Marshal(fields)
	if err != nil {
		return nil, err
	}
	message := make([]byte, 0, len(body)+len(kind)+40)
	message = append(message, `{"type":"`...)
	message = append(message, kind...)
	message = append(message, '"')
	if len(body) > 2 {
		message = append(message, ',')
	}
	return append(message, body[1:]...), nil
}

// authenticate sends the first message of a connection.
func (c *conn) authenticate(fields any) *call {
	pending := newCall("")
	message, err := encode("auth", fields)
	if err != nil {
		pending.resolve(nil, err)
		return pending
	}
	c.mu.Lock()
	c.put(message, pending)
	return pending
}

// send queues a command; what cannot be encoded is not counted as sent, so that it puts nothing out of step.
func (c *conn) send(command AnyCommand) *call {
	body, err := encode(command.command(), command)
	if err != nil {
		failed := newCall("")
		failed.resolve(nil, fmt.Errorf("nmes: %s: %w", command.command(), err))
		return failed
	}
	c.mu.Lock()
	for len(c.unsent) > writeBacklog && c.lost == nil {
		c.room.Wait()
	}
	id := strconv.FormatUint(c.count, 10)
	c.count++
	pending := newCall(id)
	message := append(append(append(body[:len(body)-1:len(body)-1], `,"id":`...), id...), '}')
	c.put(message, pending)
	return pending
}

// put sends a frame, or queues it, and its reply to come. The lock is held, and released here.
func (c *conn) put(message []byte, pending *call) {
	if c.lost != nil {
		lost := c.lost
		c.mu.Unlock()
		pending.resolve(nil, lost)
		return
	}
	c.waiting = append(c.waiting, pending)
	c.unsent = append(append(c.unsent, message...), delimiter...)
	alone := len(c.waiting) == 1 && !c.writing
	if alone {
		if c.direct {
			pending.conn = c
		}
		c.flush(nil)
	} else {
		if !c.writing {
			c.rouse()
		}
		c.readOn()
	}
	c.mu.Unlock()
}

// flush writes all that is queued, once, and returns that memory. The lock is held, but not while it writes.
func (c *conn) flush(spare []byte) []byte {
	data := c.unsent
	c.unsent, c.writing = spare[:0], true
	c.room.Broadcast()
	c.mu.Unlock()
	// Of an error the reader notices: what the server said before it hung up is read first.
	_, err := c.socket.Write(data)
	c.mu.Lock()
	c.writing = false
	if len(c.unsent) > 0 && err == nil {
		c.rouse()
	}
	return data
}

// rouse has the writer look.
func (c *conn) rouse() {
	select {
	case c.wake <- struct{}{}:
	default:
	}
}

func (c *conn) write() {
	var spare []byte
	for {
		select {
		case <-c.wake:
		case <-c.gone:
			return
		}
		c.mu.Lock()
		if len(c.unsent) > 0 && !c.writing {
			spare = c.flush(spare)
		}
		c.mu.Unlock()
	}
}

// read reads whenever nobody does who waits, until the connection is lost.
func (c *conn) read() {
	defer close(c.events) // nobody has the turn then, and nobody takes it any more
	pause := time.NewTimer(0)
	defer pause.Stop()
	for {
		c.turn <- struct{}{}
		c.background.Store(true)
		for c.failure() == nil && !c.receive() {
		}
		c.background.Store(false)
		if c.failure() != nil {
			return
		}
		<-c.turn
		for lent := true; lent; { // it was interrupted by somebody who waits
			pause.Reset(lending)
			select {
			case <-pause.C:
				lent = time.Now().UnixNano()-c.lent.Load() < int64(lending)
			case <-c.resume:
				lent = false
			case <-c.gone:
				lent = false
			}
		}
	}
}

// readOn has the goroutine that reads do so, where it has lent its turn.
func (c *conn) readOn() {
	select {
	case c.resume <- struct{}{}:
	default:
	}
}

// readFor reads until a call is answered, where nobody else does who waits too.
func (c *conn) readFor(ctx context.Context, pending *call) {
	if ctx.Done() != nil {
		defer context.AfterFunc(ctx, func() { c.socket.SetReadDeadline(past) })()
	}
	select {
	case c.turn <- struct{}{}:
	default:
		if !c.background.Load() {
			return
		}
		c.socket.SetReadDeadline(past)
		select {
		case c.turn <- struct{}{}:
		case <-pending.done:
			return
		case <-ctx.Done():
			return
		}
	}
	for !pending.resolved() && ctx.Err() == nil && c.failure() == nil {
		c.receive()
	}
	c.lent.Store(time.Now().UnixNano())
	<-c.turn
	c.mu.Lock()
	others := len(c.waiting) > 0
	c.mu.Unlock()
	if others {
		c.readOn()
	}
}

func (c *call) resolved() bool {
	select {
	case <-c.done:
		return true
	default:
		return false
	}
}

// receive reads once, and hands out what frames there are; it returns whether it was interrupted. Who calls it has the
// turn.
func (c *conn) receive() (interrupted bool) {
	if len(c.buffer) == cap(c.buffer) {
		c.buffer = append(c.buffer, 0)[:len(c.buffer)]
	}
	n, err := c.socket.Read(c.buffer[len(c.buffer):cap(c.buffer)])
	c.buffer = c.buffer[:len(c.buffer)+n]
	begin := 0
	for {
		from := max(c.searched, begin)
		at := bytes.Index(c.buffer[from:], []byte(delimiter))
		if at < 0 {
			break
		}
		frame := bytes.TrimSpace(c.buffer[begin : from+at])
		begin, c.searched = from+at+len(delimiter), 0
		if len(frame) > 0 && !c.take(bytes.Clone(frame)) {
			return false
		}
	}
	c.buffer = append(c.buffer[:0], c.buffer[begin:]...)
	c.searched = max(0, len(c.buffer)-len(delimiter)+1)
	switch {
	case len(c.buffer) > largestFrame:
		c.lose(&Disconnected{"bad_reply", fmt.Sprintf("a frame is longer than %d bytes", largestFrame)})
	case errors.Is(err, os.ErrDeadlineExceeded):
		c.socket.SetReadDeadline(time.Time{})
		return true
	case err != nil:
		c.ended(err)
	}
	return false
}

func (c *conn) ended(err error) {
	switch {
	case c.closed:
		c.lose(&Disconnected{"world_closed", "the server closed the world"})
	case errors.Is(err, net.ErrClosed):
		c.close()
	default:
		c.lose(&Disconnected{"disconnected", fmt.Sprintf("the server closed the connection: %v", err)})
	}
}

// take hands a frame to whom it is for; it returns whether the connection is still good.
func (c *conn) take(frame []byte) bool {
	var head struct {
		Type string          `json:"type"`
		ID   json.RawMessage `json:"id"`
	}
	if err := json.Unmarshal(frame, &head); err != nil {
		return c.lose(&Disconnected{"bad_reply", fmt.Sprintf("the server sent what is not a message: %v", err)})
	}
	c.mu.Lock()
	var next *call
	if len(c.waiting) > 0 && c.waiting[0].id == string(head.ID) {
		next = c.waiting[0]
		c.waiting[0] = nil
		c.waiting = c.waiting[1:]
	}
	c.mu.Unlock()
	switch {
	case next != nil && head.Type == "error":
		next.resolve(nil, refusal(frame))
	case next != nil:
		next.resolve(frame, nil)
	case head.ID != nil:
		return c.lose(&Disconnected{"bad_reply", fmt.Sprintf("the server answered a command that was not next in line: %s", head.ID)})
	case head.Type == "error": // of the connection, since commands have an id
		var told CommandError
		_ = json.Unmarshal(frame, &told) // it was read above
		return c.lose(&Disconnected{told.Code, told.Message})
	default:
		return c.tell(head.Type, frame)
	}
	return true
}

func refusal(frame []byte) error {
	told := new(CommandError)
	if err := json.Unmarshal(frame, told); err != nil {
		return &Disconnected{"bad_reply", err.Error()}
	}
	return told
}

// tell queues an event; where nobody reads, the oldest is dropped.
func (c *conn) tell(kind string, frame []byte) bool {
	event := newEvent(kind)
	if event == nil {
		event = &UnknownEvent{kind, frame}
	} else if err := json.Unmarshal(frame, event); err != nil {
		return c.lose(&Disconnected{"bad_reply", fmt.Sprintf("the event %s is not as the schemas say: %v", kind, err)})
	}
	if kind == "world_closed" {
		c.closed = true
	}
	for {
		select {
		case c.events <- event:
			return true
		default:
		}
		select {
		case <-c.events:
			c.dropped.Add(1)
		default: // somebody has read meanwhile
		}
	}
}

// lose ends the connection; the first reason is the one that counts. It returns false.
func (c *conn) lose(err error) bool {
	c.mu.Lock()
	defer c.mu.Unlock()
	if c.lost == nil {
		c.lost = err
		close(c.gone)
		c.socket.Close()
	}
	for _, pending := range c.waiting {
		pending.resolve(nil, c.lost)
	}
	c.waiting = nil
	c.room.Broadcast()
	return false
}

var errClosed = &Disconnected{"closed", "the client was closed"}

func (c *conn) close() { c.lose(errClosed) }

func (c *conn) failure() error {
	c.mu.Lock()
	defer c.mu.Unlock()
	return c.lost
}
