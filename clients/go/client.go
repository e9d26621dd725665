// Package nmes is a client of the NMES protocol: worlds of cubes, joints and creatures, driven by messages over TCP.
//
//	client, err := nmes.Dial(ctx, "127.0.0.1:14000", nmes.Options{Password: "open sesame"})
//	...
//	defer client.Close()
//	cube, err := client.SpawnCube(ctx, nmes.SpawnCube{Position: &nmes.Vector{0, 2, 0}})
//	info, err := client.GetCubeInfo(ctx, nmes.GetCubeInfo{CubeName: cube.Spawned})
//
// Each command is a method, generated from the protocol's schemas. Commands are pipelined: Send does not wait, and any
// number of goroutines may send over one client; replies come in the order in which commands were sent. A command that
// the server refuses is a *CommandError, a connection that is lost a *Disconnected.
package nmes

import (
	"cmp"
	"context"
	"crypto/tls"
	"encoding/json"
	"errors"
	"fmt"
	"os"
	"sync"
)

// Vector is x, y (up), z.
type Vector = [3]float64

// Ptr returns a pointer to a value, for fields that need not be there.
func Ptr[T any](value T) *T { return &value }

// PasswordVariable is the environment's variable that has the password where Options do not.
const PasswordVariable = "NMES_PASSWORD"

// EventBacklog is how many events wait to be read; of more the oldest are dropped.
const EventBacklog = 10_000

// Options say how to enter a world. Only a password is needed.
type Options struct {
	// Of the server; if empty, what the environment's variable NMES_PASSWORD says.
	Password string
	// The name of one of the server's worlds; its first if empty.
	World string
	// In a world with roles, one that the password opens; the first of those if empty.
	Role string
	// That of an earlier connection, to be its player again.
	Token string
	// Speak TLS, trusting what this says; nil for plain TCP.
	TLS *tls.Config
}

// password returns what the server is told.
func (o Options) password() (string, error) {
	if password := cmp.Or(o.Password, os.Getenv(PasswordVariable)); password != "" {
		return password, nil
	}
	return "", fmt.Errorf("nmes: a client needs the server's password: give Options.Password, or set %s", PasswordVariable)
}

// Client is a connection to a world. It is safe for any number of goroutines.
type Client struct {
	address  string
	entering chan struct{} // full while somebody enters

	mu      sync.Mutex // guards what follows; the connection has a lock of its own
	options Options
	welcome *AuthSuccess
	conn    *conn
	closes  int // how many times it was closed: who enters, and finds that it was meanwhile, leaves again
}

// Dial connects and enters a world.
//
// The error is a *CommandError where the server refused it (auth_failed, world_not_found, ...), else a *Disconnected, or
// that of the context.
func Dial(ctx context.Context, address string, options Options) (*Client, error) {
	var err error
	if options.Password, err = options.password(); err != nil {
		return nil, err
	}
	client := &Client{address: address, entering: make(chan struct{}, 1), options: options}
	if err := client.enter(ctx, 0); err != nil {
		return nil, err
	}
	return client, nil
}

// enter connects and enters, unless the client is closed more often than that.
func (c *Client) enter(ctx context.Context, closes int) error {
	c.mu.Lock()
	options, closed := c.options, c.closes != closes
	c.mu.Unlock()
	if closed {
		return errClosed
	}
	connection, err := open(ctx, c.address, options.TLS)
	if err != nil {
		return err
	}
	entry := struct {
		Password string `json:"password"`
		World    string `json:"world,omitempty"`
		Role     string `json:"role,omitempty"`
		Token    string `json:"token,omitempty"`
	}{options.Password, options.World, options.Role, options.Token}
	welcome, err := wait[AuthSuccess](ctx, connection.authenticate(entry))
	if err != nil {
		connection.close()
		return err
	}
	c.mu.Lock()
	defer c.mu.Unlock()
	if c.closes != closes {
		connection.close()
		return errClosed
	}
	c.conn, c.welcome = connection, welcome
	if welcome.Token != "" {
		c.options.Token = welcome.Token
	}
	return nil
}

// Welcome returns what the server said when this client entered: world, engine, ticks a second, this client's number.
func (c *Client) Welcome() AuthSuccess {
	c.mu.Lock()
	defer c.mu.Unlock()
	return *c.welcome
}

// Reconnect closes the connection and enters again: in a world with roles as the same player, while the server runs.
// Subscriptions and objectives are gone; commands that wait for replies fail, and Events gives a new channel. Of those
// who call it at once, one enters, and the others share his connection. One that Close is called in fails.
func (c *Client) Reconnect(ctx context.Context) error {
	c.mu.Lock()
	before, closes := c.conn, c.closes
	c.mu.Unlock()
	select {
	case c.entering <- struct{}{}:
		defer func() { <-c.entering }()
	case <-ctx.Done():
		return ctx.Err()
	}
	if c.current() != before {
		return nil
	}
	before.close()
	return c.enter(ctx, closes)
}

// Close ends the connection; commands that wait for replies fail, as does Reconnect that is under way. It may be called
// more than once.
func (c *Client) Close() error {
	c.mu.Lock()
	c.closes++
	c.mu.Unlock()
	c.current().close()
	return nil
}

func (c *Client) current() *conn {
	c.mu.Lock()
	defer c.mu.Unlock()
	return c.conn
}

// Err returns why the connection is lost, or nil while it is not.
func (c *Client) Err() error { return c.current().failure() }

// Events returns the channel of what the server tells unasked, once Subscribe has been called: *TickEvent, *StateEvent
// and others. It is closed when the connection is lost. Who does not read it loses the oldest; Dropped counts them.
func (c *Client) Events() <-chan Event { return c.current().events }

// Dropped returns how many events were lost since the connection began because nobody read them.
func (c *Client) Dropped() uint64 { return c.current().dropped.Load() }

// Command is a command whose reply is an R; all are generated from the schemas.
type Command[R any] interface {
	AnyCommand
	answer() *R
}

// AnyCommand is a command of whatever reply.
type AnyCommand interface{ command() string }

// Reply is in every reply.
type Reply struct {
	// The paths of fields of the command that the server does not know: perhaps it is older than this client.
	Ignored []string `json:"ignored"`
}

// Event is what the server tells those who subscribed.
type Event interface{ event() string }

// UnknownEvent is one that this client's schemas have not: perhaps the server is newer.
type UnknownEvent struct {
	Type    string
	Message json.RawMessage
}

func (e *UnknownEvent) event() string { return e.Type }

// CommandError is what the server says of a command that it refused; nothing was changed.
type CommandError struct {
	// Of docs/errors.md, such as cube_not_found.
	Code string `json:"code"`
	// For people.
	Message string `json:"message"`
	// Where in the command the reason lies: mass, position/1; empty where it lies nowhere.
	Field string `json:"field"`
}

func (e *CommandError) Error() string { return fmt.Sprintf("nmes: %s: %s", e.Code, e.Message) }

// Disconnected is why a connection is lost: it cannot be used any more.
type Disconnected struct {
	// unreachable, disconnected, world_closed, bad_reply, closed (by Close, or of an Original by a context that ended),
	// or what the server said.
	Code    string
	Message string
}

func (e *Disconnected) Error() string { return fmt.Sprintf("nmes: %s: %s", e.Code, e.Message) }

// IsCode tells whether an error is a *CommandError or *Disconnected of a code.
func IsCode(err error, code string) bool {
	var command *CommandError
	var lost *Disconnected
	return errors.As(err, &command) && command.Code == code || errors.As(err, &lost) && lost.Code == code
}

// Do sends a command and waits for its reply. When the context ends first, the command may still act.
func Do[R any](ctx context.Context, c *Client, command Command[R]) (*R, error) {
	return Send(c, command).Wait(ctx)
}

// Send sends a command without waiting. Whatever is wrong is told by Wait.
func Send[R any](c *Client, command Command[R]) Pending[R] {
	return Pending[R]{c.current().send(command)}
}

// Pending is a reply to come.
type Pending[R any] struct{ *call }

// Wait returns the reply, or why there is none: a *CommandError, a *Disconnected, or the context's error. It may be
// called by any number of goroutines, and again.
func (p Pending[R]) Wait(ctx context.Context) (*R, error) { return wait[R](ctx, p.call) }

// Outcome is what became of one command of a batch.
type Outcome struct {
	// The reply's type; error where the command was refused.
	Type    string
	Message json.RawMessage
}

// Into reads the reply into a struct of its type.
func (o Outcome) Into(reply any) error {
	if o.Type == "error" {
		return refusal(o.Message)
	}
	return json.Unmarshal(o.Message, reply)
}

// Batch has commands act with nothing in between. One that fails does not undo the earlier, but a batch that holds an
// invalid command is refused as a whole.
func (c *Client) Batch(ctx context.Context, commands ...AnyCommand) ([]Outcome, error) {
	parts := make([]json.RawMessage, len(commands))
	for i, command := range commands {
		part, err := encode(command.command(), command)
		if err != nil {
			return nil, fmt.Errorf("nmes: command %d of the batch: %w", i, err)
		}
		parts[i] = part
	}
	result, err := Do(ctx, c, batch{parts})
	if err != nil {
		return nil, err
	}
	outcomes := make([]Outcome, len(result.Results))
	for i, raw := range result.Results {
		var head struct {
			Type string `json:"type"`
		}
		if err := json.Unmarshal(raw, &head); err != nil {
			return nil, &Disconnected{"bad_reply", err.Error()}
		}
		outcomes[i] = Outcome{head.Type, raw}
	}
	return outcomes, nil
}

type batch struct {
	Commands []json.RawMessage `json:"commands"`
}

type batchResult struct {
	Results []json.RawMessage `json:"results"`
}

func (batch) command() string      { return "batch" }
func (batch) answer() *batchResult { return new(batchResult) }
