package main

import (
	"bytes"
	"encoding/json"
	"errors"
	"fmt"
	"maps"
	"math"
	"net"
	"os"
	"time"
)

const (
	delimiter = "<???DONE???---"
	patience  = 60 * time.Second
	deaf      = 200 * time.Millisecond // what stands here for the 2 to 3 s that those programs wait
	tick      = 1.0 / 60               // s
)

// Client is one connection, which takes the first frame of what it reads and throws away the rest.
type Client struct {
	connection net.Conn
}

// dial connects and says the password, and gives up unless that is right.
func dial(port int) *Client {
	connection, err := net.Dial("tcp", fmt.Sprintf("127.0.0.1:%d", port))
	must(err)
	c := &Client{connection}
	c.write([]byte(os.Getenv("NMES_PASSWORD")))
	answer := string(c.read())
	expect(answer == "auth_success", "the answer to the password is %q", answer)
	return c
}

func (c *Client) close() {
	c.connection.Close()
}

func (c *Client) write(frame []byte) {
	_, err := c.connection.Write(append(frame, delimiter...))
	must(err)
}

// read returns what comes before the first delimiter.
func (c *Client) read() []byte {
	must(c.connection.SetReadDeadline(time.Now().Add(patience)))
	var answer []byte
	buffer := make([]byte, 1024)
	for !bytes.Contains(answer, []byte(delimiter)) {
		n, err := c.connection.Read(buffer)
		must(err)
		answer = append(answer, buffer[:n]...)
	}
	return bytes.SplitN(answer, []byte(delimiter), 2)[0]
}

// readOut knows no delimiter: it reads until nothing has come for a while.
func (c *Client) readOut() []byte {
	var answer []byte
	buffer := make([]byte, 4096)
	for {
		must(c.connection.SetReadDeadline(time.Now().Add(deaf)))
		n, err := c.connection.Read(buffer)
		answer = append(answer, buffer[:n]...)
		if errors.Is(err, os.ErrDeadlineExceeded) {
			return answer
		}
		must(err)
	}
}

// tell sends a command and reads nothing.
func (c *Client) tell(command Message) {
	frame, err := json.Marshal(command)
	must(err)
	c.write(frame)
}

// ask sends a command and reads its answer into `answer`, unless that is nil; it must be of the type given.
func (c *Client) ask(command Message, kind string, answer any) {
	c.tell(command)
	frame := c.read()
	var head struct{ Type string }
	must(json.Unmarshal(frame, &head))
	expect(head.Type == kind, "%v was answered by %s", command, frame)
	if answer != nil {
		must(json.Unmarshal(frame, answer))
	}
}

// wait lets an amount of the world's time pass, in s: by the clock, or by steps where the world waits for them.
func (c *Client) wait(seconds float64) {
	if *lockstep {
		c.ask(Message{"type": "step", "ticks": int(math.Round(seconds / tick))}, "stepped", nil)
	} else {
		time.Sleep(time.Duration(seconds * float64(time.Second)))
	}
}

// until waits for something to come about, a tenth of a second at a time.
func (c *Client) until(what string, holds func() bool) {
	for n := 0; n < 200; n++ {
		if holds() {
			return
		}
		c.wait(0.1)
	}
	expect(false, "in 20 s it did not come about that %s", what)
}

func (c *Client) names() []string {
	var list struct{ Cubes []string }
	c.ask(Message{"type": "get_cube_list"}, "cube_list", &list)
	return list.Cubes
}

func (c *Client) has(name string) bool {
	for _, known := range c.names() {
		if known == name {
			return true
		}
	}
	return false
}

// join joins two cubes where they stand, and returns the joint's name; `more` may say more of it.
func (c *Client) join(kind, cube1, cube2 string, at Vector, more Message) string {
	command := Message{"type": "create_joint", "joint_type": kind, "cube1": cube1, "cube2": cube2, "position": at}
	maps.Copy(command, more)
	var joint struct {
		Name string `json:"joint_name"`
	}
	c.ask(command, "joint_created", &joint)
	return joint.Name
}

// State is how a cube moves.
type State struct {
	Name     string `json:"cube_name"`
	Position Vector
	Rotation Vector
	Velocity Vector `json:"linear_velocity"`
}

func (c *Client) state(name string) State {
	var state State
	c.ask(Message{"type": "get_cube_state", "cube_name": name}, "cube_state", &state)
	return state
}

// own is the state of the cube that this connection spawned last.
func (c *Client) own() State {
	var state State
	c.ask(Message{"type": "get_cube_state"}, "cube_state", &state)
	return state
}

// Vector is a position, a velocity or a force.
type Vector [3]float64

func (a Vector) plus(b Vector) Vector      { return Vector{a[0] + b[0], a[1] + b[1], a[2] + b[2]} }
func (a Vector) minus(b Vector) Vector     { return a.plus(b.times(-1)) }
func (a Vector) times(by float64) Vector   { return Vector{a[0] * by, a[1] * by, a[2] * by} }
func (a Vector) length() float64           { return math.Sqrt(a[0]*a[0] + a[1]*a[1] + a[2]*a[2]) }
func (a Vector) distance(b Vector) float64 { return a.minus(b).length() }
