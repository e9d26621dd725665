package main

// Sockets: framing, the two dialects, limits and time-outs. One goroutine reads a connection and executes what it says,
// one writes to it, and one lets the world tick.

import (
	"bytes"
	"crypto/sha256"
	"crypto/subtle"
	"encoding/json"
	"errors"
	"io"
	"log"
	"net"
	"sync"
	"time"
)

const (
	delimiter   = "<???DONE???---"
	fiveSeconds = 5 * time.Second
	fiveMinutes = 5 * time.Minute
	penance     = time.Second // after a wrong password
	farewell    = 2 * time.Second
	behind      = 250 * time.Millisecond // of the clock; what is more is not made up for
)

type limits struct {
	frame, authFrame, pending, connections int
	auth, idle, stall                      time.Duration
}

// Host serves one world to all who know the password.
type Host struct {
	password    string
	limits      limits
	lock        sync.Mutex // over all that follows
	world       *World
	connections int
	lastClient  int
}

func (h *Host) serve(listener net.Listener) error {
	for {
		socket, err := listener.Accept()
		if err != nil {
			return err
		}
		c := &client{host: h, socket: socket, heard: time.Now(), written: make(chan struct{})}
		c.wake = sync.NewCond(&c.lock)
		h.lock.Lock()
		full := h.connections >= h.limits.connections
		h.connections++
		h.lock.Unlock()
		go c.write()
		go func() {
			if full {
				c.fail(&failure{code: "too_many_connections", message: "the host serves as many connections as it may"}, nil, nil)
			} else {
				c.serve()
			}
			c.end()
			h.lock.Lock()
			h.connections--
			h.lock.Unlock()
		}()
	}
}

// keepTime lets the world tick, by the clock or as fast as it can.
func (h *Host) keepTime() {
	due := time.Now()
	for {
		h.lock.Lock()
		running, pause := h.world.running(), time.Duration(0)
		now := time.Now()
		if running && h.world.mode == "realtime" {
			pause = due.Sub(now)
		}
		if running && pause <= 0 {
			h.world.tick()
			due = due.Add(time.Second / tickRate)
		}
		if !running || now.Sub(due) > behind {
			due = now
		}
		h.lock.Unlock()
		if !running {
			pause = 2 * time.Millisecond
		}
		time.Sleep(min(pause, 20*time.Millisecond))
	}
}

// client is one connection.
type client struct {
	host   *Host
	socket net.Conn
	raw    bool
	owned  *cube // that it spawned last

	lock    sync.Mutex // over all that follows
	wake    *sync.Cond
	heard   time.Time // when the last frame came or went
	queue   [][]byte
	pending int // bytes in the queue
	closing bool
	written chan struct{} // closed when everything is written
}

// serve reads frames until the connection is over.
func (c *client) serve() {
	limits := c.host.limits
	var buffer []byte
	read := func(most int, until func() time.Time) ([]byte, bool) {
		searched := 0
		for {
			if end := bytes.Index(buffer[searched:], []byte(delimiter)); end >= 0 {
				end += searched
				frame := buffer[:end]
				buffer = buffer[end+len(delimiter):]
				searched = 0
				if len(frame) > most {
					c.fail(&failure{code: "frame_too_large", message: "the frame is over the limit"}, nil, nil)
					return nil, false
				}
				if frame = bytes.Trim(frame, " \t\r\n"); len(frame) > 0 {
					c.touch()
					return frame, true
				}
				continue
			}
			if searched = max(len(buffer)-len(delimiter)+1, 0); len(buffer) > most+len(delimiter) {
				c.fail(&failure{code: "frame_too_large", message: "the frame is over the limit"}, nil, nil)
				return nil, false
			}
			if err := c.socket.SetReadDeadline(until()); err != nil {
				return nil, false
			}
			piece := make([]byte, 64<<10)
			count, err := c.socket.Read(piece)
			buffer = append(buffer[:len(buffer):len(buffer)], piece[:count]...)
			var told net.Error
			if errors.As(err, &told) && told.Timeout() {
				if time.Now().Before(until()) {
					continue // something was sent meanwhile
				}
				return nil, true
			}
			if err != nil && count == 0 {
				return nil, false
			}
		}
	}

	deadline := time.Now().Add(limits.auth)
	first, there := read(limits.authFrame, func() time.Time { return deadline })
	if first == nil {
		if there {
			c.fail(&failure{code: "auth_timeout", message: "no auth came in time"}, nil, nil)
		}
		return
	}
	if !c.enter(first) {
		return
	}
	defer func() {
		c.host.lock.Lock()
		c.host.world.clients--
		c.host.lock.Unlock()
	}()
	for {
		frame, _ := read(limits.frame, func() time.Time {
			c.lock.Lock()
			defer c.lock.Unlock()
			return c.heard.Add(limits.idle)
		})
		if frame == nil || !c.execute(frame) {
			return
		}
	}
}

// enter judges the first frame, which decides the dialect.
func (c *client) enter(first []byte) bool {
	h := c.host
	if c.raw = first[0] != '{'; c.raw {
		if !h.knows(first) {
			time.Sleep(penance)
			c.send([]byte("auth_failed"))
			return false
		}
		h.join()
		c.send([]byte("auth_success"))
		return true
	}
	said, wrong := parse(first)
	if wrong == nil && said.fields["type"] != "auth" {
		wrong = &failure{"auth_failed", "the first message must be auth", "type"}
	}
	if wrong == nil {
		wrong = validate(said.fields, []field{
			{"password", true, text(1024)}, {"world", false, name}, {"list", false, boolean},
		})
	}
	if wrong == nil && !h.knows([]byte(said.fields["password"].(string))) {
		wrong = &failure{code: "auth_failed", message: "the password is wrong"}
		time.Sleep(penance)
	}
	if wanted, told := said.fields["world"]; wrong == nil && told && wanted != h.world.name {
		wrong = &failure{"world_not_found", "there is no such world", "world"}
	}
	if wrong != nil {
		c.fail(wrong, said.id, "auth")
		return false
	}
	h.lock.Lock()
	w := h.world
	if said.fields["list"] == true {
		var fault any
		if w.fault != nil {
			fault = w.fault["code"]
		}
		port := c.socket.LocalAddr().(*net.TCPAddr).Port
		c.answer(reply{"type": "world_list", "worlds": []reply{{
			"world": w.name, "port": port, "backend": "free-bodies", "mode": w.mode, "frame": w.frame,
			"clients": w.clients, "fault": fault,
		}}}, said.id)
		h.lock.Unlock()
		return false
	}
	h.lock.Unlock()
	number := h.join()
	c.answer(reply{
		"type": "auth_success", "protocol": 1, "client": number, "world": w.name, "backend": "free-bodies", "dims": 3,
		"timestep": 1.0 / tickRate, "tick_rate": tickRate, "mode": w.mode,
	}, said.id)
	return true
}

// knows compares in a time that tells nothing of the password.
func (h *Host) knows(password []byte) bool {
	given, wanted := sha256.Sum256(password), sha256.Sum256([]byte(h.password))
	return subtle.ConstantTimeCompare(given[:], wanted[:]) == 1
}

func (h *Host) join() int {
	h.lock.Lock()
	defer h.lock.Unlock()
	h.world.clients++
	h.lastClient++
	return h.lastClient
}

// execute does what a frame says and answers it; false if the connection is over.
func (c *client) execute(frame []byte) bool {
	said, wrong := parse(frame)
	if wrong != nil {
		return c.send(failed(wrong, nil, nil))
	}
	c.host.lock.Lock()
	defer c.host.lock.Unlock()
	answer, wrong, silent := c.host.world.execute(c, said.fields)
	if c.raw && silent {
		return true
	}
	if wrong != nil {
		return c.send(failed(wrong, said.id, said.fields["type"]))
	}
	return c.answer(answer, said.id)
}

// -- what is sent -------------------------------------------------------------------------------------------------

// failed writes an error; `kind` is the type of the command that failed, if it is a string.
func failed(wrong *failure, id []byte, kind any) []byte {
	told := reply{"type": "error", "code": wrong.code, "message": wrong.message}
	if wrong.field != "" {
		told["field"] = wrong.field
	}
	if _, isString := kind.(string); isString {
		told["command"] = kind
	}
	return encoded(told, id)
}

// encoded writes a reply. The encoder writes every `<` as \u003c, also in the id, which goes back as it was written.
func encoded(told reply, id []byte) []byte {
	if id != nil {
		told["id"] = json.RawMessage(id)
	}
	frame, err := json.Marshal(told)
	if err != nil {
		log.Printf("a reply cannot be written: %v", err)
		return []byte(`{"type":"error","code":"internal","message":"a reply cannot be written"}`)
	}
	return frame
}

func (c *client) answer(told reply, id []byte) bool {
	return c.send(encoded(told, id))
}

// fail tells a peer why its connection is closed.
func (c *client) fail(wrong *failure, id []byte, kind any) {
	c.send(failed(wrong, id, kind))
}

func (c *client) touch() {
	c.lock.Lock()
	c.heard = time.Now()
	c.lock.Unlock()
}

// send queues a frame; false if the connection is over. A peer that leaves too much unread is told so in place of it all.
func (c *client) send(frame []byte) bool {
	c.lock.Lock()
	defer c.lock.Unlock()
	if c.closing {
		return false
	}
	frame = append(frame[:len(frame):len(frame)], delimiter...)
	if c.pending+len(frame) > c.host.limits.pending {
		wrong := &failure{code: "slow_consumer", message: "the peer does not read what it is sent"}
		frame = append(failed(wrong, nil, nil), delimiter...)
		c.queue, c.pending, c.closing = nil, 0, true
	}
	c.queue = append(c.queue, frame)
	c.pending += len(frame)
	c.wake.Signal()
	return !c.closing
}

// end lets what is queued be written, and closes the connection so that the peer can still read it.
func (c *client) end() {
	c.lock.Lock()
	c.closing = true
	c.wake.Signal()
	c.lock.Unlock()
	<-c.written
	if tcp, isTCP := c.socket.(*net.TCPConn); isTCP && tcp.CloseWrite() == nil {
		if tcp.SetReadDeadline(time.Now().Add(farewell)) == nil {
			_, _ = io.Copy(io.Discard, tcp) // else what the peer has sent meanwhile would reset the connection
		}
	}
	_ = c.socket.Close()
}

func (c *client) write() {
	defer close(c.written)
	for {
		c.lock.Lock()
		for len(c.queue) == 0 && !c.closing {
			c.wake.Wait()
		}
		if len(c.queue) == 0 {
			c.lock.Unlock()
			return
		}
		frame := c.queue[0]
		c.queue = c.queue[1:]
		c.lock.Unlock()
		for rest := frame; len(rest) > 0; {
			piece := rest[:min(len(rest), 64<<10)]
			if c.socket.SetWriteDeadline(time.Now().Add(c.host.limits.stall)) != nil {
				break
			}
			count, err := c.socket.Write(piece)
			rest = rest[count:]
			if err != nil {
				c.lock.Lock()
				c.queue, c.closing = nil, true
				c.lock.Unlock()
				_ = c.socket.Close() // which also ends the reading
				return
			}
		}
		c.lock.Lock()
		c.pending = max(c.pending-len(frame), 0)
		c.heard = time.Now()
		c.lock.Unlock()
	}
}
