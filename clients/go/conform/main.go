// Command conform is the driver of this client for nmes conform-client: it reads one instruction a line, has the client
// do it, and writes one answer a line. The project's docs/client-conformance.md says what the instructions are.
package main

import (
	"bufio"
	"context"
	"encoding/json"
	"errors"
	"fmt"
	"log"
	"net"
	"os"
	"strconv"

	"nmes"
)

type instruction struct {
	Do       string
	Host     string
	Port     int
	Password string
	World    string
	Command  json.RawMessage
	Commands []json.RawMessage
	Count    int
}

type answer map[string]any

type driver struct{ client *nmes.Client }

func main() {
	in := bufio.NewReader(os.Stdin)
	out := json.NewEncoder(os.Stdout)
	var d driver
	for {
		line, err := in.ReadBytes('\n')
		if err != nil {
			return
		}
		var told instruction
		if err := json.Unmarshal(line, &told); err != nil {
			log.Fatal(err)
		}
		if err := out.Encode(d.obey(told)); err != nil {
			log.Fatal(err)
		}
	}
}

func (d *driver) obey(told instruction) answer {
	ctx := context.Background()
	switch told.Do {
	case "open":
		address := net.JoinHostPort(told.Host, strconv.Itoa(told.Port))
		client, err := nmes.Dial(ctx, address, nmes.Options{Password: told.Password, World: told.World})
		if err != nil {
			return failure(err)
		}
		d.client = client
		return answer{"opened": client.Welcome()}
	case "send":
		return d.send(told.Command)(ctx)
	case "pipeline":
		return d.pipeline(ctx, told.Commands)
	case "batch":
		return d.batch(ctx, told.Commands)
	case "events":
		return d.events(told.Count)
	case "close":
		if d.client != nil {
			d.client.Close()
		}
		return answer{}
	}
	return answer{"unsupported": told.Do}
}

// send sends a command as its struct; what it returns waits for the reply.
func (d *driver) send(raw json.RawMessage) func(context.Context) answer {
	command := read(raw)
	switch command := command.(type) {
	case nmes.Ping:
		return awaited(nmes.Send(d.client, command))
	case nmes.Step:
		return awaited(nmes.Send(d.client, command))
	case nmes.SpawnCube:
		return awaited(nmes.Send(d.client, command))
	case nmes.GetCubeList:
		return awaited(nmes.Send(d.client, command))
	case nmes.GetCubeState:
		return awaited(nmes.Send(d.client, command))
	case nmes.Subscribe:
		return awaited(nmes.Send(d.client, command))
	}
	panic(fmt.Sprintf("a command that the driver does not send: %T", command))
}

func read(raw json.RawMessage) nmes.AnyCommand {
	var head struct{ Type string }
	must(json.Unmarshal(raw, &head))
	switch head.Type {
	case "ping":
		return as[nmes.Ping](raw)
	case "step":
		return as[nmes.Step](raw)
	case "spawn_cube":
		return as[nmes.SpawnCube](raw)
	case "get_cube_list":
		return as[nmes.GetCubeList](raw)
	case "get_cube_state":
		return as[nmes.GetCubeState](raw)
	case "subscribe":
		return as[nmes.Subscribe](raw)
	}
	panic("a command that the driver does not know: " + head.Type)
}

func as[C any](raw json.RawMessage) C {
	var command C
	must(json.Unmarshal(raw, &command))
	return command
}

func must(err error) {
	if err != nil {
		panic(err)
	}
}

func awaited[R any](pending nmes.Pending[R]) func(context.Context) answer {
	return func(ctx context.Context) answer {
		reply, err := pending.Wait(ctx)
		if err != nil {
			return failure(err)
		}
		return answer{"reply": reply}
	}
}

func (d *driver) pipeline(ctx context.Context, commands []json.RawMessage) answer {
	waits := make([]func(context.Context) answer, len(commands))
	for i, command := range commands {
		waits[i] = d.send(command)
	}
	outcomes := make([]answer, len(waits))
	for i, wait := range waits {
		outcomes[i] = wait(ctx)
	}
	return answer{"outcomes": outcomes}
}

func (d *driver) batch(ctx context.Context, raw []json.RawMessage) answer {
	commands := make([]nmes.AnyCommand, len(raw))
	for i := range raw {
		commands[i] = read(raw[i])
	}
	results, err := d.client.Batch(ctx, commands...)
	if err != nil {
		return failure(err)
	}
	outcomes := make([]answer, len(results))
	for i, result := range results {
		var refused *nmes.CommandError
		if err := result.Into(&json.RawMessage{}); errors.As(err, &refused) {
			outcomes[i] = failure(err)
		} else {
			outcomes[i] = answer{"reply": result.Message}
		}
	}
	return answer{"outcomes": outcomes}
}

func (d *driver) events(count int) answer {
	events := []any{}
	for event := range d.client.Events() {
		kind := "unknown"
		switch event.(type) {
		case *nmes.TickEvent:
			kind = "tick"
		case *nmes.WorldFaultEvent:
			kind = "world_fault"
		case *nmes.WorldClosedEvent:
			kind = "world_closed"
		}
		fields := map[string]any{}
		raw, err := json.Marshal(event)
		must(err)
		must(json.Unmarshal(raw, &fields))
		fields["type"] = kind
		if events = append(events, fields); len(events) == count {
			break
		}
	}
	return answer{"events": events}
}

func failure(err error) answer {
	var refused *nmes.CommandError
	if errors.As(err, &refused) {
		return answer{"error": refused}
	}
	return answer{"lost": err.Error()}
}
