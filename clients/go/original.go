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
	"time"
)

// Original is a connection in the raw dialect, that of the original server: for programs that were written for it. The
// server keeps silent after spawn_cube, despawn_cube, apply_force, apply_physics, freeze_cube and set_color, whether
// they were done or not, so those are told by Tell and all others by Ask. It is for one goroutine. What is new is better
// off with Dial, where every command has an answer.
//
// Answers do not say of which command they are. So a context that ends before an answer has come ends the connection,
// too: that answer would be taken for the next one's.
type Original struct {
	socket net.Conn
	buffer []byte
	lost   error
}

// DialOriginal connects and says the password; an empty one is that of the environment's variable NMES_PASSWORD.
func DialOriginal(ctx context.Context, address, password string, config *tls.Config) (*Original, error) {
	if password == "" {
		password = os.Getenv(PasswordVariable)
	}
	if password == "" || password[0] == '{' {
		return nil, errors.New("nmes: this dialect needs a password, one that does not begin with {")
	}
	socket, err := dial(ctx, address, config)
	if err != nil {
		return nil, err
	}
	o := &Original{socket: socket}
	if err := o.write([]byte(password)); err != nil {
		return nil, err
	}
	answer, err := o.frame(ctx)
	if err != nil {
		return nil, err
	}
	if string(answer) != "auth_success" {
		o.Close()
		return nil, &CommandError{Code: string(answer), Message: "the server refused the password"}
	}
	return o, nil
}

// Tell sends a command that has no answer.
func (o *Original) Tell(command any) error {
	message, err := json.Marshal(command)
	if err != nil {
		return fmt.Errorf("nmes: %w", err)
	}
	return o.write(message)
}

// Ask sends a command and returns its answer as JSON, whatever it is. When the context ends first, the command may still
// act, and the connection is lost.
func (o *Original) Ask(ctx context.Context, command any) (json.RawMessage, error) {
	if err := ctx.Err(); err != nil {
		return nil, err
	}
	if err := o.Tell(command); err != nil {
		return nil, err
	}
	return o.frame(ctx)
}

// Close ends the connection.
func (o *Original) Close() error { return o.socket.Close() }

// lose ends the connection, and returns why it is lost.
func (o *Original) lose(code, format string, values ...any) error {
	o.lost = &Disconnected{code, fmt.Sprintf(format, values...)}
	o.socket.Close()
	return o.lost
}

func (o *Original) write(message []byte) error {
	if o.lost != nil {
		return o.lost
	}
	if _, err := o.socket.Write(append(message, delimiter...)); err != nil {
		return o.lose("disconnected", "%v", err)
	}
	return nil
}

func (o *Original) frame(ctx context.Context) ([]byte, error) {
	interrupted := make(chan struct{})
	stop := context.AfterFunc(ctx, func() {
		o.socket.SetReadDeadline(past)
		close(interrupted)
	})
	defer func() {
		if !stop() {
			<-interrupted // else the deadline could come after it is taken back
			o.socket.SetReadDeadline(time.Time{})
		}
	}()
	part := make([]byte, 64<<10)
	for searched := 0; ; {
		if at := bytes.Index(o.buffer[searched:], []byte(delimiter)); at >= 0 {
			frame := bytes.Clone(bytes.TrimSpace(o.buffer[:searched+at]))
			o.buffer = append(o.buffer[:0], o.buffer[searched+at+len(delimiter):]...)
			if len(frame) > 0 {
				return frame, nil
			}
			searched = 0
			continue
		}
		searched = max(0, len(o.buffer)-len(delimiter)+1)
		n, err := o.socket.Read(part)
		o.buffer = append(o.buffer, part[:n]...)
		if len(o.buffer) > largestFrame {
			return nil, o.lose("bad_reply", "a frame is longer than %d bytes", largestFrame)
		}
		if err != nil && n == 0 {
			if ctx.Err() != nil {
				o.lose("closed", "a context ended before its answer came, which would be taken for that of the next command")
				return nil, ctx.Err()
			}
			return nil, o.lose("disconnected", "the server closed the connection: %v", err)
		}
	}
}
