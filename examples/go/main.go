// Builds a hinged arm in the raw dialect and a pole in the json dialect, in a world that `nmes serve` hosts, and
// measures how far their motors turn them.
//
//	NMES_PASSWORD=... go run . -addr 127.0.0.1:14000
//
// It needs nothing but the standard library. Both halves work whether the world ticks by the clock or by `step`: the
// pole's asks for lockstep, and the arm's, which is as the programs for the original server are, waits and looks.
package main

import (
	"bufio"
	"bytes"
	"encoding/json"
	"errors"
	"flag"
	"fmt"
	"log"
	"math"
	"net"
	"os"
	"sort"
	"time"
)

const delimiter = "<???DONE???---"

// Message is a JSON object, whichever way it goes.
type Message map[string]any

// Client is one connection. Its read answers with the next frame and keeps what follows for later.
type Client struct {
	connection net.Conn
	reader     *bufio.Reader
}

func dial(address string) (*Client, error) {
	connection, err := net.DialTimeout("tcp", address, 5*time.Second)
	if err != nil {
		return nil, err
	}
	return &Client{connection, bufio.NewReader(connection)}, nil
}

func (c *Client) send(frame []byte) error {
	_, err := c.connection.Write(append(frame, delimiter...))
	return err
}

// read takes one frame. The delimiter ends in the only '-' that needs a look.
func (c *Client) read() ([]byte, error) {
	if err := c.connection.SetReadDeadline(time.Now().Add(30 * time.Second)); err != nil {
		return nil, err
	}
	var frame []byte
	for !bytes.HasSuffix(frame, []byte(delimiter)) {
		piece, err := c.reader.ReadBytes('-')
		if err != nil {
			return nil, err
		}
		frame = append(frame, piece...)
	}
	return bytes.TrimSuffix(frame, []byte(delimiter)), nil
}

// tell sends a command that gets no answer.
func (c *Client) tell(command Message) error {
	frame, err := json.Marshal(command)
	if err != nil {
		return err
	}
	return c.send(frame)
}

// ask sends a command and reads its answer into `reply`, which must be of the type given.
func (c *Client) ask(command Message, kind string, reply any) error {
	if err := c.tell(command); err != nil {
		return err
	}
	frame, err := c.read()
	if err != nil {
		return err
	}
	var head struct{ Type, Message string }
	if err := json.Unmarshal(frame, &head); err != nil {
		return err
	}
	if head.Type != kind {
		return fmt.Errorf("%v: got %s %s, not %s", command["type"], head.Type, head.Message, kind)
	}
	if reply == nil {
		return nil
	}
	return json.Unmarshal(frame, reply)
}

type joint struct {
	Name string `json:"joint_name"`
}

type state struct {
	Position [3]float64
	Rotation [3]float64
}

// -- the raw dialect ---------------------------------------------------------------------------------------------

// spawnRaw spawns a cube, of which the raw dialect says nothing, and looks which name is new.
func spawnRaw(c *Client, cube Message) (string, error) {
	var before, after struct{ Cubes []string }
	if err := c.ask(Message{"type": "get_cube_list"}, "cube_list", &before); err != nil {
		return "", err
	}
	cube["type"] = "spawn_cube"
	if err := c.tell(cube); err != nil {
		return "", err
	}
	known := map[string]bool{}
	for _, name := range before.Cubes {
		known[name] = true
	}
	for try := 0; try < 50; try++ {
		if err := c.ask(Message{"type": "get_cube_list"}, "cube_list", &after); err != nil {
			return "", err
		}
		sort.Strings(after.Cubes)
		for _, name := range after.Cubes {
			if !known[name] {
				return name, nil
			}
		}
		time.Sleep(200 * time.Millisecond)
	}
	return "", errors.New("the cube never appeared")
}

// arm builds two cubes on a frozen base, drives both hinges, and returns how far the outer cube was turned, in rad.
func arm(address, password string) (float64, error) {
	c, err := dial(address)
	if err != nil {
		return 0, err
	}
	defer c.connection.Close()
	if err := c.send([]byte(password)); err != nil {
		return 0, err
	}
	answer, err := c.read()
	if err != nil {
		return 0, err
	}
	if string(answer) != "auth_success" {
		return 0, fmt.Errorf("the server says %s", answer)
	}
	inner, err := spawnRaw(c, Message{"cube_name": "arm", "position": []float64{-5, 4, 0}, "is_base": true})
	if err != nil {
		return 0, err
	}
	cubes := []string{inner}
	for n := 1; n <= 2; n++ {
		x := -5 + 1.2*float64(n)
		outer, err := spawnRaw(c, Message{"position": []float64{x, 4, 0}})
		if err != nil {
			return 0, err
		}
		var made joint
		hinge := Message{
			"type": "create_joint", "cube1": inner, "cube2": outer, "joint_type": "hinge",
			"position": []float64{x - 0.6, 4, 0},
		}
		if err := c.ask(hinge, "joint_created", &made); err != nil {
			return 0, err
		}
		for _, param := range []struct {
			name  string
			value float64
		}{{"motor_target_velocity", 1}, {"motor_max_impulse", 50}} {
			set := Message{
				"type": "set_joint_param", "joint_name": made.Name, "param_name": param.name, "value": param.value,
			}
			if err := c.ask(set, "joint_param_set", nil); err != nil {
				return 0, err
			}
		}
		inner = outer
		cubes = append(cubes, outer)
	}
	var turned float64
	for try := 0; try < 50 && turned < 0.5; try++ {
		// Half a second of the world: by `step` where it waits to be told. Where it does not, that is refused.
		if err := c.tell(Message{"type": "step", "ticks": 30}); err != nil {
			return 0, err
		}
		if _, err := c.read(); err != nil {
			return 0, err
		}
		var outer state
		if err := c.ask(Message{"type": "get_cube_state", "cube_name": inner}, "cube_state", &outer); err != nil {
			return 0, err
		}
		turned = math.Abs(outer.Rotation[2])
		time.Sleep(50 * time.Millisecond)
	}
	for _, name := range cubes { // nothing is read: the next answer is that to the list
		if err := c.tell(Message{"type": "despawn_cube", "cube_name": name}); err != nil {
			return 0, err
		}
	}
	var left struct{ Cubes []string }
	if err := c.ask(Message{"type": "get_cube_list"}, "cube_list", &left); err != nil {
		return 0, err
	}
	for _, name := range left.Cubes {
		for _, gone := range cubes {
			if name == gone {
				return 0, fmt.Errorf("%s is still there", name)
			}
		}
	}
	return turned, nil
}

// -- the json dialect --------------------------------------------------------------------------------------------

// pole builds four cubes on a frozen base in lockstep, holds them upright with servos, then bends each joint, and
// returns how far the tip moved sideways, in m.
func pole(address, password string) (float64, error) {
	c, err := dial(address)
	if err != nil {
		return 0, err
	}
	defer c.connection.Close()
	if err := c.ask(Message{"type": "auth", "password": password}, "auth_success", nil); err != nil {
		return 0, err
	}
	if err := c.ask(Message{"type": "set_mode", "mode": "lockstep"}, "mode_set", nil); err != nil {
		return 0, err
	}
	var cube struct{ Spawned string }
	below := ""
	var joints []string
	for n := 0; n < 5; n++ {
		y := 0.2 + 0.5*float64(n)
		spawn := Message{
			"type": "spawn_cube", "position": []float64{5, y, 0}, "size": 0.4, "mass": 0.5, "is_base": n == 0, "list": false,
		}
		if n == 0 {
			spawn["cube_name"] = "pole"
		}
		if err := c.ask(spawn, "cube_list", &cube); err != nil {
			return 0, err
		}
		if n > 0 {
			var made joint
			hinge := Message{
				"type": "create_joint", "cube1": below, "cube2": cube.Spawned, "joint_type": "hinge",
				"position": []float64{5, y - 0.25, 0}, "axis": []float64{0, 0, 1},
				"target_position": 0.0, "motor_max_force": 500.0, "damping": 20.0,
			}
			if err := c.ask(hinge, "joint_created", &made); err != nil {
				return 0, err
			}
			joints = append(joints, made.Name)
		}
		below = cube.Spawned
	}
	tip := func() (state, error) {
		var at state
		err := c.ask(Message{"type": "step", "ticks": 120}, "stepped", nil)
		if err == nil {
			err = c.ask(Message{"type": "get_cube_state", "cube_name": below}, "cube_state", &at)
		}
		return at, err
	}
	upright, err := tip()
	if err != nil {
		return 0, err
	}
	for _, name := range joints {
		bend := Message{
			"type": "set_joint_param", "joint_name": name, "param_name": "target_position", "value": 0.15,
		}
		if err := c.ask(bend, "joint_param_set", nil); err != nil {
			return 0, err
		}
	}
	bent, err := tip()
	if err != nil {
		return 0, err
	}
	return math.Abs(bent.Position[0] - upright.Position[0]), nil
}

func main() {
	log.SetFlags(0)
	address := flag.String("addr", "127.0.0.1:14000", "where the world is served")
	password := flag.String("password", os.Getenv("NMES_PASSWORD"), "the password; better in NMES_PASSWORD")
	flag.Parse()
	turned, err := arm(*address, *password)
	if err != nil {
		log.Fatalf("arm: %v", err)
	}
	moved, err := pole(*address, *password)
	if err != nil {
		log.Fatalf("pole: %v", err)
	}
	report := map[string]float64{"arm_turned": turned, "pole_moved": moved}
	if err := json.NewEncoder(os.Stdout).Encode(report); err != nil {
		log.Fatal(err)
	}
	if turned < 0.5 || moved < 0.3 {
		log.Fatal("the motors did not move what they should have")
	}
}
